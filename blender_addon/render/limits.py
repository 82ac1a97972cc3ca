# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures of hands cannot show of a scene: panes before them, volumes, soft edges; in sentences for the panel.

Hands come into the pictures of Cycles and EEVEE by depth, and what is seen through has one depth. Panels look by
`ui.kept`, on its timer; where no material is seen through, no object is asked.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np
from bpy.app.translations import pgettext_rpt as rpt_

from .. import versions
from ..hand import seen_hands
from . import ENGINE, composite, scene_light, scene_shadows, worlds

# what has materials
_SURFACES = {"MESH", "CURVE", "SURFACE", "FONT", "META", "VOLUME"}
# kinds of materials
PANE, VOLUME = "pane", "volume"
_PANES = {"BSDF_TRANSPARENT", "BSDF_GLASS", "BSDF_REFRACTION"}
# inputs of a Principled BSDF, and what opaque ones have
_OPAQUE = {"Alpha": 1.0, "Transmission Weight": 0.0}
# so far away are eyes that see in parallel, Blender units
_FAR = 1e4
# sentences name the first of them
_NAMED = 3


def sentences(context: bpy.types.Context) -> tuple[str, ...]:
    """About the scene of the context, as its camera sees it."""
    scene, depsgraph = context.scene, context.evaluated_depsgraph_get()
    is_mixed = scene.render.engine != ENGINE or composite.has_combination(scene)
    found = list(_of_view(scene, depsgraph)) if is_mixed else []
    kinds = {name: kind for name, kind in map(_kind, bpy.data.materials) if kind}
    if not (kinds or bpy.data.volumes):
        return tuple(found)
    hands, _ = seen_hands.read(seen_hands.hands_of(scene, context.view_layer), depsgraph)
    if not hands:
        return tuple(found)
    joints = np.concatenate([hand.joints_world_m for hand in hands]) / scene.unit_settings.scale_length
    from_eye = _ways_of_sight(scene.camera, joints) if is_mixed and scene.camera is not None else joints[:0]
    from_lamps = _ways_of_light(depsgraph, joints) if scene_light.is_chosen(scene) else joints[:0]
    panes, volumes, shades = {}, {}, {}
    for thing, matrix in _things(depsgraph):
        kind = _kind_of(thing, kinds)
        if kind and _meets(from_eye, joints, thing, matrix):
            (panes if kind == PANE else volumes)[thing.name] = None
        if kind == PANE and thing.visible_shadow and _meets(from_lamps, joints, thing, matrix):
            shades[thing.name] = None
    for names, text in (
        (panes, rpt_("{name}: no hand is seen through it; move it out of the camera's way")),
        (volumes, rpt_("{name}: a volume does not dim hands; add mist in the compositor")),
        (shades, rpt_("{name}: seen through, but shades hands as a whole; turn off Shadow in its Ray Visibility")),
    ):
        if names:
            found.append(text.format(name=", ".join([*names][:_NAMED]) + ", …" * (len(names) > _NAMED)))
    return tuple(found)


def _of_view(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> Iterator[str]:
    world = worlds.world_in(depsgraph.scene_eval, depsgraph.view_layer_eval)
    output = _output(world) if world is not None else None
    if output is not None and output.inputs["Volume"].is_linked:
        yield rpt_("The volume of the world does not dim hands; add mist in the compositor")
    if scene.camera is not None and scene.camera.type == "CAMERA" and scene.camera.data.dof.use_dof:
        yield rpt_("Depth of field: no hand is seen through soft edges of things before it; keep these in focus")


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


def _kind_of(thing: bpy.types.Object, kinds: dict[str, str]) -> str:
    if thing.type == "VOLUME":
        return VOLUME
    own = (slot.material and kinds.get(slot.material.name_full) for slot in thing.material_slots)
    return next(filter(None, own), "")


# ---- what is between -------------------------------------------------------------------------------------------------


def _things(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, np.ndarray]]:
    """What is seen and has materials, and its place, also of instances of collections; those that particles and nodes
    make are too many to ask, and small."""
    for each in depsgraph.object_instances:
        thing = each.object
        is_part = not each.is_instance or each.parent.instance_type == "COLLECTION"
        if is_part and thing.type in _SURFACES and thing.visible_camera and each.show_self:
            yield thing, np.array(each.matrix_world)


def _ways_of_sight(camera: bpy.types.Object, joints: np.ndarray) -> np.ndarray:
    """(N, 3) from each joint (N, 3) to where a camera sees it from."""
    matrix = np.array(camera.matrix_world)
    if camera.type == "CAMERA" and camera.data.type == "ORTHO":
        return np.tile(matrix[:3, 2] * _FAR, (len(joints), 1))
    return matrix[:3, 3] - joints


def _ways_of_light(depsgraph: bpy.types.Depsgraph, joints: np.ndarray) -> np.ndarray:
    """(lamps * N, 3) from each joint to each lamp."""
    ways = []
    for each in depsgraph.object_instances:
        if each.object.type == "LIGHT":
            matrix = np.array(each.matrix_world)
            is_sun = each.object.data.type == "SUN"
            ways.append(np.tile(matrix[:3, 2] * _FAR, (len(joints), 1)) if is_sun else matrix[:3, 3] - joints)
    return np.concatenate([joints[:0], *ways])


def _meets(ways: np.ndarray, joints: np.ndarray, thing: bpy.types.Object, matrix: np.ndarray) -> bool:
    """Whether ways from the joints, in turn, come through the box of a thing."""
    if not len(ways) or not np.linalg.det(matrix[:3, :3]):
        return False
    back = np.linalg.inv(matrix)
    corners = np.array([tuple(corner) for corner in thing.bound_box])
    starts = np.tile(joints, (len(ways) // len(joints), 1)) @ back[:3, :3].T + back[:3, 3]
    box = np.stack([corners.min(0), corners.max(0)])
    return bool(scene_shadows.meet_box(starts, ways @ back[:3, :3].T, box).any())
