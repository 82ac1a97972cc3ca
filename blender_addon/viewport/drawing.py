# SPDX-License-Identifier: GPL-3.0-or-later
"""A picture of the engine as textures, and drawing it into a view. Only to be used while Blender draws.

The engine's picture is premultiplied; display-referred sRGB, or scene-linear in the light of a scene. What a custom
shader writes into a view is taken as linear, so the shader decodes sRGB (on straight colors) and the view shows the
engine's numbers. Each pixel is tested against the scene at its own depth. Source: BLENDER 7.2 and 7.3.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Euler, Matrix

from .. import versions
from ..core.view import Part

_VERTEX = """
void main()
{
  uv = pos;
  gl_Position = vec4(mix(place.xy, place.zw, pos), 0.0, 1.0);
}
"""

# The picture may have fewer pixels than the part of the view that it fills: colors are blended between four pixels,
# decoded; depths never are, a depth half way between a finger and nothing would float in front of everything.
_FRAGMENT = """
vec4 color_at(ivec2 at)
{
  vec4 c = texelFetch(picture, clamp(at, ivec2(0), textureSize(picture, 0) - 1), 0);
  if (c.a <= 0.0 || linear_it == 1) {
    return c;
  }
  vec3 shown = min(c.rgb / c.a, vec3(1.0));
  vec3 linear = mix(shown / 12.92, pow((shown + 0.055) / 1.055, vec3(2.4)), step(vec3(0.04045), shown));
  return vec4(linear * c.a, c.a);
}

float depth_at(ivec2 at)
{
  return texelFetch(depth_m, clamp(at, ivec2(0), textureSize(depth_m, 0) - 1), 0).r;
}

void main()
{
  vec2 at = vec2(uv.x, 1.0 - uv.y) * vec2(textureSize(picture, 0));
  ivec2 here = ivec2(floor(at));
  vec4 color;
  float depth = depth_at(here);
  if (smooth_it == 0) {
    color = color_at(here);
  }
  else {
    ivec2 first = ivec2(floor(at - 0.5));
    vec2 part = at - 0.5 - vec2(first);
    vec4 above = mix(color_at(first), color_at(first + ivec2(1, 0)), part.x);
    vec4 below = mix(color_at(first + ivec2(0, 1)), color_at(first + ivec2(1, 1)), part.x);
    color = mix(above, below, part.y);
    if (depth <= 0.0) {
      depth = max(max(depth_at(first), depth_at(first + ivec2(1, 0))),
                  max(depth_at(first + ivec2(0, 1)), depth_at(first + ivec2(1, 1))));
    }
  }
  if (color.a < 0.5 / 255.0) {
    discard;
  }
  vec2 clip = clip_from_depth.xz * depth + clip_from_depth.yw;
  float between = 0.5 * clip.x / clip.y + 0.5;
  if (between < 0.0 || between > 1.0) {
    discard;
  }
  gl_FragDepth = between;
  shown_color = color;
}
"""

_CORNERS = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))


# the shader of pictures and its four corners
_Tools = tuple[gpu.types.GPUShader, gpu.types.GPUBatch]
_tools: _Tools | None = None
# textures that no view needs any more: freed when Blender draws the next time, which has the right context for it
_unwanted: list[GpuPicture | _Tools] = []
# Blender makes textures of floats only. Converting a picture into memory that is already there takes a tenth of what it
# takes with new memory, which the system has to find and to clear first.
_floats = np.empty(0, np.float32)


class GpuPicture:
    """Textures of one picture. Keep it until the drawing is over: one that is freed earlier leaves the view black.

    rgba: (H, W, 4) premultiplied, top row first: uint8 of sRGB, or float32 that is scene-linear; depth_m: (H, W)
    float32 along the view axis, 0 = nothing.
    """

    def __init__(self, rgba: np.ndarray, depth_m: np.ndarray) -> None:
        self.height, self.width = depth_m.shape
        self._linear = rgba.dtype == np.float32
        self._color = self._texture(
            rgba if self._linear else _as_floats(rgba), 4, "RGBA16F" if self._linear else "RGBA8"
        )
        self._depth = self._texture(depth_m.astype(np.float32, copy=False), 1, "R32F")

    def draw(
        self, part: Part, region: tuple[int, int], clip: tuple[float, float, float, float], *, behind_scene: bool
    ) -> None:
        """Fills a part of a view of that many pixels. clip: as `ViewCamera.clip_of_depth` gives it; behind_scene:
        whether things of the scene that are nearer hide it."""
        shader, quad = _made_tools()
        width, height = region
        left, right = 2 * part.left / width - 1, 2 * part.right / width - 1
        bottom, top = 1 - 2 * part.bottom / height, 1 - 2 * part.top / height
        gpu.state.blend_set("ALPHA_PREMULT")
        gpu.state.depth_test_set("LESS_EQUAL" if behind_scene else "NONE")
        gpu.state.depth_mask_set(False)
        try:
            shader.bind()
            shader.uniform_float("place", (left, bottom, right, top))
            shader.uniform_float("clip_from_depth", clip)
            same_size = (part.width, part.height) == (self.width, self.height)
            shader.uniform_int("smooth_it", 0 if same_size else 1)
            shader.uniform_int("linear_it", int(self._linear))
            shader.uniform_sampler("picture", self._color)
            shader.uniform_sampler("depth_m", self._depth)
            quad.draw(shader)
        finally:
            gpu.state.depth_test_set("NONE")
            gpu.state.blend_set("NONE")

    def _texture(self, values: np.ndarray, channels: int, kind: str) -> gpu.types.GPUTexture:
        flat = np.ascontiguousarray(values).ravel()
        data = gpu.types.Buffer("FLOAT", self.width * self.height * channels, flat)
        return gpu.types.GPUTexture((self.width, self.height), format=kind, data=data)


def discard(picture: GpuPicture | None) -> None:
    if picture is not None:
        _unwanted.append(picture)


def free_unwanted() -> None:
    """Frees what was discarded. Only at the beginning of a draw: none of it was drawn since the one before ended."""
    _unwanted.clear()


def renew() -> None:
    """Makes the shader anew with the next picture: the driver may have lost it."""
    global _tools
    if _tools is not None:
        _unwanted.append(_tools)
        _tools = None


def forget() -> None:
    global _tools, _floats
    _tools = None
    _floats = np.empty(0, np.float32)
    _unwanted.clear()


def _as_floats(rgba: np.ndarray) -> np.ndarray:
    """uint8 as float32 from 0 to 1, flat; good until the next call."""
    global _floats
    if rgba.size > _floats.size:
        _floats = np.empty(rgba.size, np.float32)
    return np.multiply(rgba.ravel(), np.float32(1 / 255), out=_floats[: rgba.size])


def _made_tools() -> _Tools:
    global _tools
    if _tools is None:
        between = gpu.types.GPUStageInterfaceInfo("jghand_picture_between")
        between.smooth("VEC2", "uv")
        info = gpu.types.GPUShaderCreateInfo()
        info.push_constant("VEC4", "place")
        info.push_constant("VEC4", "clip_from_depth")
        info.push_constant("INT", "smooth_it")
        info.push_constant("INT", "linear_it")
        info.sampler(0, "FLOAT_2D", "picture")
        info.sampler(1, "FLOAT_2D", "depth_m")
        info.vertex_in(0, "VEC2", "pos")
        info.vertex_out(between)
        info.fragment_out(0, "VEC4", "shown_color")
        info.depth_write("ANY")
        info.vertex_source(_VERTEX)
        info.fragment_source(_FRAGMENT)
        shader = gpu.shader.create_from_info(info)
        _tools = shader, batch_for_shader(shader, "TRI_STRIP", {"pos": _CORNERS})
    return _tools


# ---- bones that are to be seen in front of everything ----------------------------------------------------------------
# Blender has drawn its overlays when a draw handler comes, so the picture would hide the bones of an armature that is
# shown in front, and the finger controls with them. Along those lines the picture is left out instead: the depth there
# is set to the nearest there is, without touching colors, and what Blender drew shows. Rendered mode needs none of it.

# how wide the picture of a hand is left open for its bones and for the wires of its controls, pixels: no wider than
# Blender draws them; and the most wires of one control
BONE_CUT_PX, SHAPE_CUT_PX, SHAPE_EDGES_MAX = 3.0, 1.5, 512

_NEAREST = -0.99999


def keep_bones_visible(things: Sequence[bpy.types.Object], context: bpy.types.Context) -> None:
    """Keeps a picture that is drawn next from hiding the bones of these hands in the view that Blender draws now."""
    space = context.space_data
    if not (space.overlay.show_overlays and space.overlay.show_bones):
        return
    depsgraph = context.evaluated_depsgraph_get()
    bones: list[np.ndarray] = []
    shapes: list[np.ndarray] = []
    for thing in things:
        if _is_in_front(thing, context):
            for lines, is_shape in _lines(thing.evaluated_get(depsgraph)):
                (shapes if is_shape else bones).append(lines)
    for lines, width_px in ((bones, BONE_CUT_PX), (shapes, SHAPE_CUT_PX)):
        if lines:
            _cut(np.concatenate(lines), width_px * context.preferences.system.ui_scale)


def _is_in_front(thing: bpy.types.Object, context: bpy.types.Context) -> bool:
    return (
        thing.type == "ARMATURE"
        and thing.show_in_front
        and thing.mode != "EDIT"
        and thing.visible_get(view_layer=context.view_layer, viewport=context.space_data)
    )


def _lines(evaluated: bpy.types.Object) -> Iterator[tuple[np.ndarray, bool]]:
    """(N, 2, 3) ends of lines in the world for every visible bone, and whether they are its custom shape."""
    world = evaluated.matrix_world
    shaped = evaluated.data.show_bone_custom_shapes
    for bone in versions.visible_bones(evaluated):
        shape = bone.custom_shape if shaped else None
        if shape is None:
            yield np.array([[world @ bone.head, world @ bone.tail]], np.float32), False
        elif shape.type == "MESH" and 0 < len(shape.data.edges) <= SHAPE_EDGES_MAX:
            yield _wires(shape.data, np.array(world @ _shape_matrix(bone), np.float32)), True


def _shape_matrix(bone: bpy.types.PoseBone) -> Matrix:
    base = bone.custom_shape_transform or bone
    size = bone.bone.length if bone.use_custom_shape_bone_size else 1.0
    scale = Matrix.Diagonal((*(size * each for each in bone.custom_shape_scale_xyz), 1.0))
    turn = Euler(bone.custom_shape_rotation_euler).to_matrix().to_4x4()
    return base.matrix @ Matrix.Translation(bone.custom_shape_translation) @ turn @ scale


def _wires(mesh: bpy.types.Mesh, matrix: np.ndarray) -> np.ndarray:
    points = np.empty((len(mesh.vertices), 3), np.float32)
    mesh.vertices.foreach_get("co", points.ravel())
    edges = np.empty((len(mesh.edges), 2), np.int32)
    mesh.edges.foreach_get("vertices", edges.ravel())
    return (points @ matrix[:3, :3].T + matrix[:3, 3])[edges]


def _cut(lines: np.ndarray, width_px: float) -> None:
    shader = gpu.shader.from_builtin("POLYLINE_UNIFORM_COLOR")
    batch = batch_for_shader(shader, "LINES", {"pos": lines.reshape(-1, 3)})
    projection = gpu.matrix.get_projection_matrix()
    projection[2] = projection[3] * _NEAREST
    gpu.state.color_mask_set(False, False, False, False)
    gpu.state.depth_mask_set(True)
    gpu.state.depth_test_set("ALWAYS")
    try:
        with gpu.matrix.push_pop_projection():
            gpu.matrix.load_projection_matrix(projection)
            shader.bind()
            shader.uniform_float("viewportSize", gpu.state.viewport_get()[2:])
            shader.uniform_float("lineWidth", width_px)
            shader.uniform_float("color", (0.0, 0.0, 0.0, 1.0))
            batch.draw(shader)
    finally:
        gpu.state.depth_test_set("NONE")
        gpu.state.depth_mask_set(False)
        gpu.state.color_mask_set(True, True, True, True)
