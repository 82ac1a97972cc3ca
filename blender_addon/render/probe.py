# SPDX-License-Identifier: GPL-3.0-or-later
"""A light probe: what comes from a world, whatever its nodes are, and from what is around a place.

Cycles bakes it on a ball of small facets in a scene of its own, which is gone afterwards (`handover`): nothing of the
user's is changed, no render is lost. That takes a tenth of a second and more, and is nothing for draw or render
handlers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from .. import versions
from ..core import worlds
from ..errors import JGHandFailure
from . import handover

# of the ball, meters
RADIUS_M = 0.02
# paths from each facet: noise of white ones evens out among them
SAMPLES, BOUNCES = 64, 4
# columns of the map by which Cycles aims at what is bright in a sky; it aims at the sun apart
SKY_AIM = 256
NAME = "JGHand Light Probe"
_SHADERS = ("ShaderNodeBsdfAnisotropic", "ShaderNodeBsdfDiffuse")


def is_possible() -> bool:
    return "cycles" in bpy.types.Scene.bl_rna.properties


def is_own(scene: bpy.types.Scene) -> bool:
    """Whether a scene is there for a probe alone: what is said of it is no edit of the artist's."""
    return scene.name.startswith(NAME)


@dataclass(frozen=True)
class Around:
    """What is around a place of a scene: place, in Blender units; things, which shine, throw light back or are in its
    way; lamps, which light the things, but are no part of what is measured."""

    place: tuple[float, float, float]
    things: tuple[bpy.types.Object, ...]
    lamps: tuple[bpy.types.Object, ...]


def measure(
    scene: bpy.types.Scene,
    world: bpy.types.World | None,
    sun: worlds.Sun | None = None,
    around: Around | None = None,
) -> worlds.WorldLight:
    """The light of a world at the frame of a scene, scene-linear, in Blender's axes. Raises JGHandFailure (no_cycles,
    world_bake)."""
    looks = worlds.probe(sun)
    made: list[Any] = []
    try:
        own = new_scene(scene, world, made)
        ball = _ball(looks, RADIUS_M / scene.unit_settings.scale_length, made)
        own.collection.objects.link(ball)
        if around is not None:
            ball.location = around.place
            for thing in (*around.things, *_lamps_for_others(around.lamps, ball, made)):
                own.collection.objects.link(thing)
        out = bake(own, [ball])
    finally:
        handover.put_away(made)
    return worlds.measured(looks, out)


def _lamps_for_others(
    lamps: Iterable[bpy.types.Object], ball: bpy.types.Object, made: list[Any]
) -> Iterator[bpy.types.Object]:
    """Copies of lamps, which do not light the ball, nor show in its mirrors."""
    hidden = bpy.data.collections.new(NAME)
    made.append((bpy.data.collections, hidden))
    hidden.objects.link(ball)
    hidden.collection_objects[0].light_linking.link_state = "EXCLUDE"
    for lamp in lamps:
        copy = lamp.copy()
        made.append((bpy.data.objects, copy))
        # one that lights chosen objects only lights none that may throw its light back
        if copy.light_linking.receiver_collection is None:
            copy.light_linking.receiver_collection = hidden
            copy.visible_glossy = False
            yield copy


def measure_sky(scene: bpy.types.Scene, sky: bpy.types.Node, sun: worlds.Sun | None) -> worlds.WorldLight:
    """The same of an evaluated Sky Texture node alone, in the node's axes, with the sun apart."""
    made = [(bpy.data.worlds, world := bpy.data.worlds.new(NAME))]
    try:
        tree = versions.ensure_tree(world)
        tree.nodes.clear()
        copy, output = tree.nodes.new(sky.bl_idname), tree.nodes.new("ShaderNodeOutputWorld")
        background = tree.nodes.new("ShaderNodeBackground")
        of_all = {*bpy.types.ShaderNode.bl_rna.properties.keys(), "texture_mapping", "color_mapping"}
        for name in set(sky.bl_rna.properties.keys()) - of_all:
            setattr(copy, name, getattr(sky, name))
        tree.links.new(copy.outputs["Color"], background.inputs["Color"])
        tree.links.new(background.outputs["Background"], output.inputs["Surface"])
        if hasattr(world, "cycles"):
            world.cycles.sampling_method, world.cycles.sample_map_resolution = "MANUAL", SKY_AIM
        return measure(scene, world, sun)
    finally:
        handover.put_away(made)


def new_scene(
    of: bpy.types.Scene, world: bpy.types.World | None, made: list[Any], samples: int = SAMPLES
) -> bpy.types.Scene:
    """A scene to bake in, at the frame of another. made: gets (collection of bpy.data, data-block) of all that is to be
    removed. JGHandFailure: no_cycles."""
    scene = bpy.data.scenes.new(NAME)
    made.append((bpy.data.scenes, scene))
    scene.world = world
    # what is keyed or driven is evaluated anew there
    scene.frame_current, scene.frame_subframe = of.frame_current, of.frame_subframe
    try:
        scene.render.engine = "CYCLES"
    except TypeError as error:  # the add-on is disabled
        raise JGHandFailure("no_cycles") from error
    cycles = scene.cycles
    cycles.samples, cycles.max_bounces, cycles.seed = samples, BOUNCES, 0
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    # clamped or blurred light would be missing
    cycles.sample_clamp_indirect = cycles.blur_glossy = 0.0
    scene.render.bake.target = "VERTEX_COLORS"
    return scene


def _ball(looks: worlds.Probe, radius: float, made: list[Any]) -> bpy.types.Object:
    """Triangles that look in all directions, each flat: between smooth ones light would be lost below their edges."""
    ball = new_facets(radius * worlds.triangles(looks.place, looks.normal, looks.size), made)
    ball.data.polygons.foreach_set("material_index", looks.is_white.astype(np.int32))
    for name in _SHADERS:
        ball.data.materials.append(new_material(name, (1.0, 1.0, 1.0, 1.0), made))
    return ball


def new_facets(corners: np.ndarray, made: list[Any]) -> bpy.types.Object:
    """Triangles (N, 3, 3) that can be baked. made: see `new_scene`"""
    mesh = bpy.data.meshes.new(NAME)
    made.append((bpy.data.meshes, mesh))
    points = corners.reshape(-1, 3)
    mesh.from_pydata(points, [], np.arange(len(points)).reshape(-1, 3))
    mesh.color_attributes.active_color = mesh.color_attributes.new(NAME, "FLOAT_COLOR", "POINT")
    thing = bpy.data.objects.new(NAME, mesh)
    made.append((bpy.data.objects, thing))
    return thing


def new_material(shader: str, rgba: tuple[float, float, float, float], made: list[Any]) -> bpy.types.Material:
    """Of one shader that reflects so much. made: see `new_scene`"""
    material = bpy.data.materials.new(NAME)
    made.append((bpy.data.materials, material))
    tree = versions.ensure_tree(material)
    tree.nodes.clear()
    node, output = tree.nodes.new(shader), tree.nodes.new("ShaderNodeOutputMaterial")
    node.inputs["Color"].default_value = rgba
    node.inputs["Roughness"].default_value = 0.0
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    return material


def bake(scene: bpy.types.Scene, things: list[bpy.types.Object]) -> np.ndarray:
    """(facets, 3) radiance that goes out of each of those of `new_facets` in `new_scene`. JGHandFailure: world_bake."""
    layer = scene.view_layers[0]
    layer.update()
    for thing in things:
        thing.select_set(True, view_layer=layer)
    first = layer.objects.active = things[0]
    with bpy.context.temp_override(
        scene=scene, view_layer=layer, active_object=first, object=first, selected_objects=things
    ):
        try:
            end = bpy.ops.object.bake(type="COMBINED")
        except RuntimeError as error:  # an error report of Blender's
            raise JGHandFailure("world_bake", str(error)) from error
    if end != {"FINISHED"}:  # nothing was written: that would be black
        raise JGHandFailure("world_bake", ", ".join(end))
    return np.concatenate([_baked(thing) for thing in things])


def _baked(facets: bpy.types.Object) -> np.ndarray:
    attribute = facets.data.color_attributes[NAME]
    values = np.empty(4 * len(attribute.data), np.float32)
    attribute.data.foreach_get("color", values)
    return values.reshape(-1, 3, 4)[..., :3].mean(1)
