# SPDX-License-Identifier: GPL-3.0-or-later
"""A bake as an object that plays: Blender's own import of the stage's points, with a look that shows their colors.

The object needs neither engine nor extension afterwards: a point cloud whose cache modifier reads the USD file, and a
material of Blender's own nodes. Points are balls, so edges are harder than those of splats; builds that know Gaussian
splats import those instead.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import folders, versions
from ..core import limits
from ..errors import JGHandFailure
from .bakes import BakedHand

# custom property of a playing object: the folder of its bake, relative where the bake's settings are so
BAKE_PROPERTY = "jghand_bake"
MATERIAL = "JGHand Points"
# prims of the stage that are drawn: what the variants hold
_PATHS = "/Hand/Points,/Hand/Splats"


def play(context: bpy.types.Context, hand: BakedHand, folder: Path) -> bpy.types.Object:
    """Imports the points of one baked hand into the scene. JGHandFailure: no_usd, no_bake."""
    if not versions.has_usd():
        raise JGHandFailure("no_usd")
    before = set(bpy.data.objects)
    try:
        bpy.ops.wm.usd_import(
            filepath=str(hand.stage(folder)), prim_path_mask=_PATHS, set_frame_range=False, relative_path=True
        )
    except RuntimeError as error:
        raise JGHandFailure("no_bake", f"{hand.stage(folder)}: {error}") from error
    added = [thing for thing in bpy.data.objects if thing not in before]
    clouds = [thing for thing in added if thing.type == "POINTCLOUD"]
    if not clouds:
        for thing in added:
            bpy.data.objects.remove(thing)
        raise JGHandFailure("no_usd", "its import brought no points")
    cloud = clouds[0]
    cloud.name = cloud.data.name = f"{hand.name} baked"
    cloud[BAKE_PROPERTY] = folders.beside_the_file(context, folder)
    unit_m = context.scene.unit_settings.scale_length
    cloud.scale = [size / unit_m for size in cloud.scale]
    if not cloud.data.materials:
        cloud.data.materials.append(points_material())
    return cloud


def stop(context: bpy.types.Context, folder: Path) -> int:
    """Takes the objects that play a bake out of the scene; returns how many there were.

    Their cache goes with them: USD keeps a file that is open as it was read, and a new bake would not be seen.
    """
    old = playing(context.scene, folder)
    for thing in old:
        cloud = thing.data
        bpy.data.objects.remove(thing)
        if not cloud.users:
            bpy.data.batch_remove([cloud])
    bpy.data.batch_remove([cache for cache in bpy.data.cache_files if _is_in(cache, folder) and not cache.users])
    if old:
        context.view_layer.update()
    return len(old)


def _is_in(cache: bpy.types.CacheFile, folder: Path) -> bool:
    return folder in Path(bpy.path.abspath(cache.filepath, library=cache.library)).parents


def playing(scene: bpy.types.Scene, folder: Path) -> list[bpy.types.Object]:
    """The objects of a scene that play a bake."""
    wanted = folder.resolve()
    return [thing for thing in scene.objects if BAKE_PROPERTY in thing and played_folder(thing).resolve() == wanted]


def played_folder(thing: bpy.types.Object) -> Path:
    """The folder of the bake that an object plays."""
    return Path(bpy.path.abspath(str(thing[BAKE_PROPERTY]), library=thing.library))


def points_material() -> bpy.types.Material:
    """Shows the colors of the points as they are: no light falls on them, as on a photograph."""
    known = bpy.data.materials.get(MATERIAL)
    if known is not None and known.library is None:
        return known
    material = bpy.data.materials.new(MATERIAL)
    material.diffuse_color = limits.POINTS_SOLID_RGBA  # Solid mode knows no colors of points
    if material.node_tree is None:  # until 4.5
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    color = tree.nodes.new("ShaderNodeAttribute")
    color.attribute_name, color.location = "displayColor", (-300, 0)
    glow = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location = (300, 0)
    tree.links.new(color.outputs["Color"], glow.inputs["Color"])
    tree.links.new(glow.outputs["Emission"], output.inputs["Surface"])
    return material
