# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact Light: all light that falls on hands in a render, as Cycles finds it.

    light = with_baked(light, depsgraph, seen, is_canceled)     within a render

Cycles bakes small facets above the skin of the hands, in a scene of its own in which things, lamps and world of the
rendered one stand, and the surfaces of the hands: so lamps of every kind, what things throw back and take, panels that
shine and light linking are as in the picture beside the hands. The engine keeps what skin mirrors to itself.

Where a render runs on the main thread (no window) it is done in render_pre, before the frame: a bake within `render`
ends Blender. In a window it is handed over to the main thread.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import bpy
import numpy as np

from .. import clock
from ..core.stand_in import FINE_POINTS, Surface, points_on, surface_at
from ..core.view import LIGHT_FROM_WORLD, HandInSpace, SceneLight, is_picked
from ..core.worlds import LOOKS, above_skin, fields
from ..errors import JGHandFailure
from ..hand import armature, stand_ins
from . import handover, lamps, probe, samples, scene_light, worlds

# paths from each corner of a facet: six corners of a point look along the normal, and the engine takes the mean of some
# nine points, that is 200 paths, or 2 % of noise
SAMPLES = 4
# looks of facets that others must not see; a camera's is none of a bake's
_SEEN_BY = ("diffuse", "glossy", "transmission", "volume_scatter", "shadow")


@dataclass(frozen=True)
class _Stage:
    """A scene in which the light of the same hands is baked, frame by frame.

    hands:  their surfaces
    facets: above the skin of each
    """

    scene: bpy.types.Scene
    hands: list[bpy.types.Object]
    facets: list[bpy.types.Object]


# by scene, view layer and hands
_stages: dict[tuple[object, ...], _Stage] = {}
# what was baked before the frame that is rendered on the main thread, by scene and view layer: its hands and their
# fields, see `_bake`, or why there are none
_ready: dict[tuple[int, str], tuple[Sequence[HandInSpace], np.ndarray | None] | JGHandFailure] = {}


def is_chosen(scene: bpy.types.Scene) -> bool:
    return scene_light.is_chosen(scene) and scene.jghand.use_exact_light


def prepare(depsgraph: bpy.types.Depsgraph) -> None:
    """Bakes before a frame that is rendered on the main thread. For render_pre alone."""
    scene, layer = depsgraph.scene, depsgraph.view_layer.name
    _ready.pop((scene.session_uid, layer), None)
    if not is_chosen(scene):
        return
    try:
        hands = samples.hands_to_render(depsgraph)
        _ready[scene.session_uid, layer] = hands, _baked(scene, layer, hands)
    except JGHandFailure as failure:
        _ready[scene.session_uid, layer] = failure
    finally:
        clear()


def with_baked(
    light: SceneLight | None,
    depsgraph: bpy.types.Depsgraph,
    seen: Sequence[HandInSpace],
    is_canceled: Callable[[], bool],
) -> SceneLight | None:
    """A light with what falls on the hands of a render, where its scene wants that. Raises JGHandFailure (exact_light,
    no_cycles, canceled, bad_joints)."""
    scene, layer = depsgraph.scene, depsgraph.view_layer.name
    if light is None or not seen or not is_chosen(scene):
        return light
    done = _ready.pop((scene.session_uid, layer), ((), None))
    if handover.is_possible():
        # those of the frame, as without a window, and not of a moment of the shutter
        hands = samples.hands_at(depsgraph)
        done = hands, handover.do(partial(_baked, scene, layer, hands), is_canceled)
    if isinstance(done, JGHandFailure):
        raise done
    hands, baked = done
    if baked is None or _sides(hands) != _sides(seen):
        raise JGHandFailure("exact_light")
    return replace(light, baked=baked)


def tend() -> None:
    if handover.tend():
        _stages.clear()


def expect() -> None:
    _stages.clear()
    handover.expect()


def clear() -> None:
    _stages.clear()
    handover.clear()


def _baked(scene: bpy.types.Scene, layer: str, hands: Sequence[HandInSpace]) -> np.ndarray | None:
    """What `_bake` finds of any hands. Raises JGHandFailure (exact_light, no_cycles), whatever fails."""
    try:
        return _bake(scene, scene.view_layers[layer], hands) if hands else None
    except JGHandFailure as failure:
        if failure.kind != "world_bake":  # which tells of the world
            raise
        raise JGHandFailure("exact_light", failure.detail) from failure
    except Exception as error:
        clock.tell_once(error)
        raise JGHandFailure("exact_light", f"{type(error).__name__}: {error}") from error


def _sides(hands: Sequence[HandInSpace]) -> list[str]:
    return [hand.handedness for hand in hands]


def _bake(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, hands: Sequence[HandInSpace]) -> np.ndarray:
    """(hands, FINE_POINTS, 4, 3) light at points of the skin, see the engine's `Baked`. On the main thread."""
    turn = LIGHT_FROM_WORLD[:3, :3]
    surfaces = [surface_at(hand.joints_world_m @ turn.T, hand.handedness) for hand in hands]
    places = [points_on(surface, FINE_POINTS) for surface in surfaces]
    key = scene.session_uid, layer.name, *(hand.called for hand in hands)
    stage = _stages.get(key)
    if stage is None:
        stage = _stages[key] = _new_stage(scene, layer, hands, surfaces)
    own = stage.scene
    own.world = worlds.world_in(scene, layer)
    own.frame_current, own.frame_subframe = scene.frame_current, scene.frame_subframe
    to_scene = turn / scene.unit_settings.scale_length
    shapes = [surface.vertices for surface in surfaces] + [above_skin(*place).reshape(-1, 3) for place in places]
    for thing, vertices in zip([*stage.hands, *stage.facets], shapes, strict=True):
        thing.data.vertices.foreach_set("co", (vertices @ to_scene).ravel())
        thing.data.update()
    normals = np.concatenate([normals for _, normals in places])
    found = fields(probe.bake(own, stage.facets) @ worlds.rec709_from_scene().T, normals)
    return found.reshape(len(hands), FINE_POINTS, 4, 3).astype("<f4")


def _new_stage(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, hands: Sequence[HandInSpace], surfaces: Sequence[Surface]
) -> _Stage:
    made: list[Any] = []
    try:
        own = probe.new_scene(scene, None, made, SAMPLES)
        white = probe.new_material("ShaderNodeBsdfDiffuse", (1.0, 1.0, 1.0, 1.0), made)
        facets, skins = [], []
        for hand, surface in zip(hands, surfaces, strict=True):
            above = probe.new_facets(np.zeros((LOOKS * FINE_POINTS, 3, 3)), made)
            above.data.materials.append(white)
            for name in _SEEN_BY:
                setattr(above, f"visible_{name}", False)
            mesh = bpy.data.meshes.new(probe.NAME)
            made.append((bpy.data.meshes, mesh))
            mesh.from_pydata(surface.vertices, [], surface.faces)
            color = (*stand_ins.skin_rgb(hand.avatar), 1.0)
            mesh.materials.append(probe.new_material("ShaderNodeBsdfDiffuse", color, made))
            facets.append(above)
            skins.append(bpy.data.objects.new(probe.NAME, mesh))
            made.append((bpy.data.objects, skins[-1]))
        there = armature.rendered_at_any_frame(layer, _is_there)
        there = [_linked(thing, facets, skins, hands, made) if thing.type == "LIGHT" else thing for thing in there]
        for thing in (*facets, *skins, *there):
            own.collection.objects.link(thing)
        return _Stage(own, skins, facets)
    finally:
        handover.leave(made)


def _is_there(thing: bpy.types.Object) -> bool:
    """Whether an object shines, throws light back or takes it, or instances what does; hands are there themselves."""
    return worlds.is_surface(thing) or thing.type == "LIGHT" or (thing.is_instancer and armature.STAND_IN not in thing)


def _linked(
    lamp: bpy.types.Object,
    facets: Sequence[bpy.types.Object],
    skins: Sequence[bpy.types.Object],
    hands: Sequence[HandInSpace],
    made: list[Any],
) -> bpy.types.Object:
    """A lamp that lights the facets and skins of hands, and is shaded by skins, as its light linking has it with the
    hands; a copy where that is to be said."""
    linking = lamp.light_linking
    receivers = _with_ours(linking.receiver_collection, (*facets, *skins), (*hands, *hands), made)
    blockers = _with_ours(linking.blocker_collection, skins, hands, made)
    if (receivers, blockers) == (linking.receiver_collection, linking.blocker_collection):
        return lamp
    copy = lamp.copy()
    made.append((bpy.data.objects, copy))
    copy.name = probe.NAME
    copy.light_linking.receiver_collection, copy.light_linking.blocker_collection = receivers, blockers
    return copy


def _with_ours(
    linked: bpy.types.Collection | None,
    ours: Sequence[bpy.types.Object],
    hands: Sequence[HandInSpace],
    made: list[Any],
) -> bpy.types.Collection | None:
    """Receivers or blockers of a lamp, with what is ours as its hand is; a copy where that is to be said."""
    if linked is None:
        return None
    picked = lamps.picked_by(linked)
    states = {how.light_linking.link_state for how in (*linked.collection_objects, *linked.collection_children)}
    # what is not named is excluded as soon as something is included
    names_lit = "INCLUDE" in states
    named = [thing for thing, hand in zip(ours, hands, strict=True) if is_picked(hand.called, picked) == names_lit]
    if not named:
        return linked
    copy = linked.copy()
    made.append((bpy.data.collections, copy))
    copy.name = probe.NAME
    for thing in named:
        copy.objects.link(thing)
        copy.collection_objects[-1].light_linking.link_state = "INCLUDE" if names_lit else "EXCLUDE"
    return copy
