# SPDX-License-Identifier: GPL-3.0-or-later
"""Plays a bake in a Blender that was built without USD, by the extension alone: no engine.

The object is a mesh of loose vertices that a handler moves at every frame, and Blender's own nodes that make balls of
them. Its frames are read from the bake's `.splat` files. Where Blender has USD, `baked_points` plays instead, and not
even the extension is needed then. Renders want Lock Interface, as with every handler (BLENDER 8.2): playing turns it
on. A frame that cannot be read is an empty mesh, never the frame before it, and renders of it fail (`guard`).
"""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np
from bpy.app.handlers import persistent

from .. import folders
from ..errors import JGHandFailure
from .baked_points import BAKE_PROPERTY, played_folder, points_material
from .bakes import BakedHand
from .splat_cache import CachedFrame, frame_path, read_frame

# custom properties of a playing mesh: stem of its files, and the frames that there are
NAME_PROPERTY, RANGE_PROPERTY = "jghand_bake_name", "jghand_bake_range"
GROUP = "JGHand Points"
# per point, beside its place: its name, Blender's type
_ATTRIBUTES = (("radius", "FLOAT"), ("displayColor", "FLOAT_COLOR"))
# session_uid of a playing object -> why the frame that is shown is not there
_failures: dict[int, JGHandFailure] = {}
# whether anything in the opened file plays; None where that was not looked at yet. Most scenes have nothing that does,
# and many objects to be asked at every frame
_plays: bool | None = None


def play(context: bpy.types.Context, hand: BakedHand, folder: Path, *, width: float) -> bpy.types.Object:
    """An object that plays one baked hand. width: diameter of a ball in two standard deviations.

    JGHandFailure: no_bake where the bake has no frames of its own for this player.
    """
    read_frame(frame_path(folder, hand.name, hand.first_frame))
    mesh = bpy.data.meshes.new(f"{hand.name} baked")
    mesh.materials.append(points_material())
    thing = bpy.data.objects.new(mesh.name, mesh)
    thing[BAKE_PROPERTY], thing[NAME_PROPERTY] = folders.beside_the_file(context, folder), hand.name
    thing[RANGE_PROPERTY] = [hand.first_frame, hand.first_frame + hand.frames - 1]
    thing.scale = [1.0 / context.scene.unit_settings.scale_length] * 3
    modifier = thing.modifiers.new("Balls", "NODES")
    modifier.node_group = _balls(width)
    context.scene.collection.objects.link(thing)
    context.scene.render.use_lock_interface = True
    _may_play()
    show_frame(thing, context.scene.frame_current)
    return thing


def show_frame(thing: bpy.types.Object, frame: int) -> None:
    """Moves a playing object to a frame; beyond its range it stays at the end. JGHandFailure (no_bake): the frame is
    not there, and nothing is shown."""
    first, last = thing[RANGE_PROPERTY]
    path = frame_path(played_folder(thing), str(thing[NAME_PROPERTY]), min(max(frame, first), last))
    _failures.pop(thing.session_uid, None)
    try:
        _fill(thing.data, read_frame(path))
    except JGHandFailure as failure:
        _failures[thing.session_uid] = failure
        thing.data.clear_geometry()
        raise
    finally:
        thing.data.update_tag()


def failure_in(scene: bpy.types.Scene) -> JGHandFailure | None:
    """Why what plays in a scene is not in its renders now; None where all is well."""
    if not _failures:
        return None
    things = [thing for thing in scene.objects if thing.session_uid in _failures and not thing.hide_render]
    return _failures[things[0].session_uid] if things else None


@persistent
def _may_play(*_: object) -> None:
    """Objects came by another way than `play`: from a file, or by undo."""
    global _plays
    _plays = None


@persistent
def _on_frame(scene: bpy.types.Scene, _depsgraph: bpy.types.Depsgraph | None = None) -> None:
    global _plays
    if _plays is None:
        _plays = any(NAME_PROPERTY in thing for thing in bpy.data.objects)
    if not _plays:
        return
    for thing in scene.objects:
        if NAME_PROPERTY in thing and thing.type == "MESH":
            try:
                show_frame(thing, scene.frame_current)
            except JGHandFailure as failure:
                print(f"JGHand: {thing.name}: {failure}")  # a handler that throws is switched off by nobody


_HANDLERS = (
    ("frame_change_post", _on_frame),
    ("load_post", _may_play),
    ("blend_import_post", _may_play),
    ("undo_post", _may_play),
    ("redo_post", _may_play),
)


def register() -> None:
    """Adds the handlers."""
    _may_play()
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler not in handlers:
            handlers.append(handler)


def unregister() -> None:
    """Takes them away; playing objects stay as they are."""
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    _failures.clear()


def _fill(mesh: bpy.types.Mesh, frame: CachedFrame) -> None:
    if not mesh.vertices:
        mesh.vertices.add(len(frame.positions_m))
        for name, kind in _ATTRIBUTES:
            mesh.attributes.new(name, kind, "POINT")
    if len(mesh.vertices) != len(frame.positions_m):
        raise JGHandFailure("no_bake", "its frames are of different avatars")
    mesh.vertices.foreach_set("co", np.ascontiguousarray(frame.positions_m, np.float32).ravel())
    mesh.attributes["radius"].data.foreach_set("value", np.ascontiguousarray(frame.radius_m, np.float32))
    mesh.attributes["displayColor"].data.foreach_set("color", np.ascontiguousarray(frame.rgba, np.float32).ravel())
    mesh.update()


def _balls(width: float) -> bpy.types.NodeTree:
    """Nodes: vertices become points of their own radius, with the object's material."""
    tree = bpy.data.node_groups.new(GROUP, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    start, end = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    radius = tree.nodes.new("GeometryNodeInputNamedAttribute")
    radius.data_type = "FLOAT"
    radius.inputs["Name"].default_value = "radius"
    wide = tree.nodes.new("ShaderNodeMath")
    wide.operation = "MULTIPLY"
    wide.inputs[1].default_value = width
    points = tree.nodes.new("GeometryNodeMeshToPoints")
    look = tree.nodes.new("GeometryNodeSetMaterial")
    look.inputs["Material"].default_value = points_material()
    tree.links.new(start.outputs[0], points.inputs["Mesh"])
    tree.links.new(radius.outputs["Attribute"], wide.inputs[0])
    tree.links.new(wide.outputs[0], points.inputs["Radius"])
    tree.links.new(points.outputs[0], look.inputs["Geometry"])
    tree.links.new(look.outputs[0], end.inputs[0])
    return tree
