# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures of hands cannot show of a scene: panes before them, volumes, soft edges; in sentences for the panel.

Hands come into the pictures of Cycles and EEVEE by depth, and what is seen through has one depth. Panels look by
`ui.kept`, on its timer; where no material is seen through, or nothing was edited since the last look, no object is
asked, nor is any while Blender renders or plays. Things are asked by their boxes: a hollow one may be named too often,
but not a room with windows around both a hand and what sees or lights it.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from .. import versions
from ..core.panel_text import listed
from ..core.view import LIGHT_FROM_WORLD
from ..hand import armature, seen_hands
from . import ENGINE, composite, handover, lamps, rendering, scene_light, scene_shadows, worlds

# kinds of materials
PANE, VOLUME = "pane", "volume"
_PANES = {"BSDF_TRANSPARENT", "BSDF_GLASS", "BSDF_REFRACTION"}
# inputs of a Principled BSDF, and what opaque ones have
_OPAQUE = {"Alpha": 1.0, "Transmission Weight": 0.0}
# so far away are eyes that see in parallel, Blender units
_FAR = 1e4
# what Blender gives as meshes beside itself
_AS_MESHES = {"CURVE", "SURFACE", "FONT", "META"}
# sentences name the first of them
_NAMED = 3
# scenes whose sentences are kept
_SCENES = 4

# (session_uid of the scene, name of the view layer) -> what it was looked at for, and what was found
_kept: dict[tuple[int, str], tuple[tuple[object, ...], tuple[str, ...]]] = {}


def sentences(context: bpy.types.Context) -> tuple[str, ...]:
    """About the scene of the context, as its camera sees it; while Blender renders or plays, what was found last."""
    scene, layer = context.scene, context.view_layer
    place = scene.session_uid, layer.name
    last = _kept.get(place, ((), ()))
    is_playing = context.screen is not None and context.screen.is_animation_playing
    if is_playing or rendering.now() or handover.is_blender_busy():
        return last[1]
    depsgraph = context.evaluated_depsgraph_get()
    is_mixed = scene.render.engine != ENGINE or composite.has_combination(scene)
    found = tuple(_of_view(scene, depsgraph)) if is_mixed else ()
    kinds = {name: kind for name, kind in map(_kind, bpy.data.materials) if kind}
    things = seen_hands.hands_of(scene, layer) if kinds or bpy.data.volumes else []
    hands, _ = seen_hands.read(things, depsgraph)
    unit_m = scene.unit_settings.scale_length
    joints = np.concatenate([np.empty((0, 3)), *(hand.joints_world_m for hand in hands)]) / unit_m
    from_eye = from_lamps = joints[:0]
    if is_mixed and scene.camera is not None:
        from_eye = _ways_of_sight(scene.camera, joints)
    # Exact Light bakes what comes through panes
    if hands and scene_light.is_chosen(scene) and not scene.jghand.use_exact_light:
        from_lamps = _ways_of_light(lamps.in_view(depsgraph, None, things), joints, unit_m)
    key = (
        found,
        is_mixed,
        frozenset(kinds.items()),
        scene_shadows.edits,
        *(each.tobytes() for each in (joints, from_eye, from_lamps)),
    )
    if last[0] != key:
        if hands:
            found += tuple(_between(depsgraph, kinds, joints, from_eye, from_lamps))
        if not is_mixed:
            found += left_out(layer)
        if len(_kept) >= _SCENES:
            _kept.clear()
        last = _kept[place] = key, found
    return last[1]


def left_out(layer: bpy.types.ViewLayer) -> tuple[str, ...]:
    """A sentence about what images of hands alone do not have of a view layer; none where that is nothing."""
    known: seen_hands.Known = {}

    def wanted(thing: bpy.types.Object) -> bool:
        return worlds.is_surface(thing) and not thing.hide_render

    found = armature.rendered_at_any_frame(layer, lambda thing: seen_hands.shows(thing, wanted, known))
    things = [thing.name for thing in found]
    text = f'JGHand renders hands alone, without {listed(things, _NAMED)}. "Set Up Compositing" renders both'
    return (text,) if things else ()


def _between(
    depsgraph: bpy.types.Depsgraph,
    kinds: dict[str, str],
    joints: np.ndarray,
    from_eye: np.ndarray,
    from_lamps: np.ndarray,
) -> Iterator[str]:
    """About what is between the joints (N, 3), and what sees and lights them; kinds: of materials, by their names."""
    panes, volumes, shades, parts = {}, {}, {}, {}
    for thing, matrix in _things(depsgraph):
        own = _kinds_of(thing, kinds)
        if VOLUME in own and _meet(from_eye, joints, thing, matrix):
            volumes[thing.name] = None
        if PANE in own and _meet(from_eye, joints, thing, matrix, around=False):
            panes[thing.name] = None
        if PANE in own and thing.visible_shadow and _meet(from_lamps, joints, thing, matrix, around=False):
            (shades if set(own) == {PANE} else parts)[thing.name] = None
    for names, text in (
        (panes, "{name}: no hand is seen through it; move it out of the camera's way"),
        (volumes, "{name}: a volume does not dim hands; add mist in the compositor"),
        (shades, "{name}: seen through, but shades hands as a whole; turn off Shadow in its Ray Visibility"),
        (parts, "{name}: its panes shade hands; separate them, then turn off Shadow in their Ray Visibility"),
    ):
        if names:
            yield text.format(name=listed([*names], _NAMED))


def _of_view(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Iterator[str]:
    world = worlds.world_in(depsgraph.scene_eval, depsgraph.view_layer_eval)
    output = _output(world) if world is not None else None
    if output is not None and output.inputs["Volume"].is_linked:
        yield "The volume of the world does not dim hands; add mist in the compositor"
    if scene.camera is not None and scene.camera.type == "CAMERA" and scene.camera.data.dof.use_dof:
        yield "Depth of field: no hand is seen through soft edges of things before it; keep these in focus"


# ---- materials -------------------------------------------------------------------------------------------------------


def _kind(material: bpy.types.Material) -> tuple[str, str]:
    """Its name in the file, and PANE, VOLUME, or "" for what hides what is behind it."""
    output = _output(material)
    if output is None:
        return material.name_full, ""
    # to follow links takes as long as there are links: only where a node is there that may count
    nodes: list[bpy.types.Node] = material.node_tree.nodes
    if any(node.type == "GROUP" or _lets_through(node) for node in nodes) and any(
        map(_lets_through, _before(output.inputs["Surface"]))
    ):
        return material.name_full, PANE
    is_volume = output.inputs["Volume"].is_linked and not output.inputs["Surface"].is_linked
    return material.name_full, VOLUME if is_volume else ""


def _output(owner: bpy.types.Material | bpy.types.World) -> bpy.types.Node | None:
    tree = versions.world_tree(owner)
    return tree.get_output_node("CYCLES") if tree is not None else None


def _before(socket: bpy.types.NodeSocket) -> Iterator[bpy.types.Node]:
    """The shaders that go into a socket, and all nodes of groups among them."""
    seen, sockets = set(), [socket]
    while sockets:
        for link in sockets.pop().links:
            node = link.from_node
            if node.name not in seen:
                seen.add(node.name)
                sockets.extend(each for each in node.inputs if each.type == "SHADER" and each.is_linked)
                yield node
                if node.type == "GROUP" and node.node_tree is not None:
                    yield from node.node_tree.nodes


def _lets_through(node: bpy.types.Node) -> bool:
    if node.type != "BSDF_PRINCIPLED":
        return node.type in _PANES
    inputs = ((node.inputs[name], opaque) for name, opaque in _OPAQUE.items())
    return any(socket.is_linked or socket.default_value != opaque for socket, opaque in inputs)


def _kinds_of(thing: bpy.types.Object, kinds: dict[str, str]) -> list[str]:
    """Of each material slot of a thing."""
    if thing.type == "VOLUME":
        return [VOLUME]
    return [kinds.get(slot.material.name_full, "") if slot.material else "" for slot in thing.material_slots]


# ---- what is between -------------------------------------------------------------------------------------------------


def _things(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """What is seen and has materials, and its place, also of instances of collections; those that particles and nodes
    make are too many to ask, and small. Blender gives curves, texts and balls as meshes that these instance."""
    for each in depsgraph.object_instances:
        thing, parent = each.object, each.parent
        is_part = not each.is_instance or parent.instance_type == "COLLECTION" or parent.type in _AS_MESHES
        is_surface = thing.type in ("MESH", "VOLUME") and armature.STAND_IN not in thing
        if is_part and is_surface and thing.visible_camera and each.show_self:
            yield thing, np.array(each.matrix_world)


def _ways_of_sight(camera: bpy.types.Object, joints: np.ndarray) -> np.ndarray:
    """(N, 3) from each joint (N, 3) to where a camera sees it from."""
    matrix = np.array(camera.matrix_world)
    if camera.type == "CAMERA" and camera.data.type == "ORTHO":
        return np.tile(matrix[:3, 2] * _FAR, (len(joints), 1))
    return matrix[:3, 3] - joints


def _ways_of_light(found: lamps.SceneLamps, joints: np.ndarray, unit_m: float) -> np.ndarray:
    """(lamps * N, 3) from each joint to each lamp that casts shadows."""
    ways = []
    for lamp in found.lamps:
        if lamp["has_shadow"]:
            place = LIGHT_FROM_WORLD[:3, :3].T @ lamp["place_m"]
            is_sun = lamp["kind"] == "sun"
            ways.append(np.tile(place * _FAR, (len(joints), 1)) if is_sun else place / unit_m - joints)
    return np.concatenate([joints[:0], *ways])


def _meet(
    ways: np.ndarray, joints: np.ndarray, thing: bpy.types.Object, matrix: np.ndarray, *, around: bool = True
) -> bool:
    """Whether one of the ways from the joints, in turn, comes through the box of a thing. around: or lies inside it."""
    if not len(ways) or not np.linalg.det(matrix[:3, :3]):
        return False
    back = np.linalg.inv(matrix)
    corners = np.array([tuple(corner) for corner in thing.bound_box])
    box = np.stack([corners.min(0), corners.max(0)])
    starts = np.tile(joints, (len(ways) // len(joints), 1)) @ back[:3, :3].T + back[:3, 3]
    ways = ways @ back[:3, :3].T
    ends = np.stack([starts, starts + ways])
    inside = ((ends > box[0]) & (ends < box[1])).all((0, -1))
    return bool((scene_shadows.meet_box(starts, ways, box) & (around | ~inside)).any())
