# SPDX-License-Identifier: GPL-3.0-or-later
"""Bones that are to be seen in front of everything stay visible before the picture of their own hand.

Blender has drawn its overlays when a draw handler comes, so the picture would hide the bones of an armature that is
shown in front, and the finger controls with them. Along those lines the picture is left out instead: the depth there
is set to the nearest there is, without touching colors, and what Blender drew shows. Rendered mode needs none of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Euler, Matrix

# how wide the picture of a hand is left open for its bones and for the wires of its controls, pixels: no wider than
# Blender draws them; and the most wires of one control
BONE_CUT_PX, SHAPE_CUT_PX, SHAPE_EDGES_MAX = 3.0, 1.5, 512

_NEAREST = -0.99999


def keep_visible(things: Sequence[bpy.types.Object], context: bpy.types.Context) -> None:
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
    for bone in evaluated.pose.bones:
        if not _is_visible(bone):
            continue
        shape = bone.custom_shape if shaped else None
        if shape is None:
            yield np.array([[world @ bone.head, world @ bone.tail]], np.float32), False
        elif shape.type == "MESH" and 0 < len(shape.data.edges) <= SHAPE_EDGES_MAX:
            yield _wires(shape.data, np.array(world @ _shape_matrix(bone), np.float32)), True


def _is_visible(bone: bpy.types.PoseBone) -> bool:
    # where a bone's hiding is kept differs between versions; a line too many would be a hole in the hand
    if bone.bone.hide or getattr(bone, "hide", False):
        return False
    collections = bone.bone.collections
    return not collections or any(collection.is_visible_effectively for collection in collections)


def _shape_matrix(bone: bpy.types.PoseBone) -> Matrix:
    """Where a bone's custom shape lies, in the armature."""
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
    """Sets the depth along lines to the nearest there is."""
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
