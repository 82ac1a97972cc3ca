# SPDX-License-Identifier: GPL-3.0-or-later
"""Exact Light: all light that falls on hands in a render, as Cycles finds it.

    light = with_baked(light, depsgraph, seen, is_canceled)     within a render

Cycles bakes small facets above the skin of the hands, in a scene of its own in which things, lamps and world of the
rendered one stand, and the surfaces of the hands: so lamps of every kind, what things throw back and take, panels that
shine and light linking are as in the picture beside the hands. The engine keeps what skin mirrors to itself.

Where a render runs on the main thread (no window) it is done in render_pre, before the frame: a bake within `render`
ends Blender. In a window the render's thread waits for the timer, which bakes on the main thread. What was made for
that stays until no render goes on: what is removed while Blender renders ends it, what is made does not (run, 5.2.2).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from .. import clock
from ..core import facets
from ..core.stand_in import FINE_POINTS, Surface, points_on, surface_at
from ..core.view import LIGHT_FROM_WORLD, HandInSpace, SceneLight
from ..errors import JGHandFailure
from ..hand import armature, stand_ins
from . import lamps, probe, rendering, samples, scene_light, worlds

# paths from each corner of a facet: six corners of a point look along the normal, and the engine takes the mean of some
# nine points, that is 200 paths, or 2 % of noise
SAMPLES = 4
# how often a render looks whether it was canceled, seconds
_POLL_S = 0.05
# what a bake makes, each with the probe's name
_KINDS = ("scenes", "objects", "meshes", "materials", "collections")
# custom property of all that: names alone may be an artist's
_MARK = "jghand_exact_light"
# looks of facets that others must not see; a camera's is none of a bake's
_SEEN_BY = ("diffuse", "glossy", "transmission", "volume_scatter", "shadow")


@dataclass(frozen=True)
class _Stage:
    """A scene in which the light of the same hands is baked, frame by frame.

    hands:  their surfaces
    facets: above the skin of all of them
    """

    scene: bpy.types.Scene
    hands: list[bpy.types.Object]
    facets: bpy.types.Object


@dataclass
class _Ask:
    """What a render waits for. is_canceled: whether it was given up; baked: the answer, or failure"""

    scene: bpy.types.Scene
    layer: str
    hands: Sequence[HandInSpace]
    is_canceled: Callable[[], bool]
    baked: np.ndarray | None = None
    failure: JGHandFailure | None = None
    is_done: threading.Event = field(default_factory=threading.Event)


# by scene, view layer and hands; whether anything was made that is to be taken away
_stages: dict[tuple[object, ...], _Stage] = {}
_is_untidy = False
# what the render's thread waits for
_ask: _Ask | None = None
# what was baked before the frame that is rendered on the main thread, by scene and view layer
_ready: dict[tuple[int, str], _Ask] = {}


def is_chosen(scene: bpy.types.Scene) -> bool:
    """Whether renders of a scene bake the light of its hands."""
    return scene_light.is_chosen(scene) and scene.jghand.use_exact_light


def prepare(depsgraph: bpy.types.Depsgraph) -> None:
    """Bakes before a frame that is rendered on the main thread. For render_pre alone."""
    scene, layer = depsgraph.scene, depsgraph.view_layer
    _ready.pop((scene.session_uid, layer.name), None)
    if not is_chosen(scene):
        return
    ask = _ready[(scene.session_uid, layer.name)] = _Ask(scene, layer.name, (), lambda: False)
    try:
        ask.hands = samples.hands_to_render(depsgraph)
        _answer(ask)
    except JGHandFailure as failure:
        ask.failure = failure
    finally:
        clear()


def with_baked(
    light: SceneLight | None,
    depsgraph: bpy.types.Depsgraph,
    seen: Sequence[HandInSpace],
    is_canceled: Callable[[], bool],
) -> SceneLight | None:
    """A light with what falls on the hands of a render, where its scene wants that. Raises JGHandFailure (exact_light,
    world_bake, no_cycles, canceled, bad_joints)."""
    global _ask
    scene, layer = depsgraph.scene, depsgraph.view_layer.name
    if light is None or not seen or not is_chosen(scene):
        return light
    if threading.current_thread() is threading.main_thread():
        done = _ready.pop((scene.session_uid, layer), None)
    elif clock.runs():
        # those of the frame, as without a window, and not of a moment of the shutter
        done = _ask = _Ask(scene, layer, samples.hands_at(depsgraph), is_canceled)
        while not done.is_done.wait(_POLL_S):
            if is_canceled():
                _ask = None
                raise JGHandFailure("canceled")
    else:
        done = None
    if done is not None and done.failure is not None:
        raise done.failure
    if done is None or done.baked is None or _sides(done.hands) != _sides(seen):
        raise JGHandFailure("exact_light")
    return replace(light, baked=done.baked)


def tend() -> None:
    """For the timer: bakes what a render waits for, and tidies up after the last one."""
    global _ask
    ask = _ask
    if ask is not None:
        _ask = None
        _answer(ask)
    elif _is_untidy and not rendering.is_blender_busy():
        clear()


def expect() -> None:
    """After an undo: what was remembered during a bake is there again, and goes as soon as it may."""
    global _is_untidy
    _stages.clear()
    _is_untidy = any(map(_made_in, _KINDS))
    if _is_untidy:
        clock.hasten(0.0)


def clear() -> None:
    """Takes away what bakes made; known by its mark, as an undo may have taken or renewed some of it."""
    global _is_untidy
    _stages.clear()
    for kind in _KINDS:
        for thing in _made_in(kind):
            getattr(bpy.data, kind).remove(thing)
    _is_untidy = False


def _made_in(kind: str) -> list[Any]:
    return [thing for thing in getattr(bpy.data, kind) if _MARK in thing and thing.library is None]


def _answer(ask: _Ask) -> None:
    """Bakes; a failure, whatever it is, ends the wait of the render, too. Not after Esc, which a bake makes Blender
    forget: it would write an empty frame and go on."""
    try:
        if ask.is_canceled():
            raise JGHandFailure("canceled")
        ask.baked = _bake(ask.scene, ask.scene.view_layers[ask.layer], ask.hands) if ask.hands else None
    except JGHandFailure as failure:
        is_bake = failure.kind == "world_bake"  # which tells of the world
        ask.failure = JGHandFailure("exact_light", failure.detail) if is_bake else failure
    except Exception as error:
        clock.tell_once(error)
        ask.failure = JGHandFailure("exact_light", f"{type(error).__name__}: {error}")
    finally:
        ask.is_done.set()


def _sides(hands: Sequence[HandInSpace]) -> list[str]:
    return [hand.handedness for hand in hands]


def _bake(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, hands: Sequence[HandInSpace]) -> np.ndarray:
    """(hands, FINE_POINTS, 4, 3) light at points of the skin, see the engine's `Baked`. On the main thread."""
    global _is_untidy
    turn = LIGHT_FROM_WORLD[:3, :3]
    surfaces = [surface_at(hand.joints_world_m @ turn.T, hand.handedness) for hand in hands]
    places = [points_on(surface, FINE_POINTS) for surface in surfaces]
    points, normals = map(np.concatenate, zip(*places, strict=True))
    key = scene.session_uid, layer.name, *_sides(hands)
    stage = _stages.get(key)
    if stage is None:
        _is_untidy = True
        stage = _stages[key] = _new_stage(scene, layer, surfaces)
    own = stage.scene
    own.world = worlds.world_in(scene, layer)
    own.frame_current, own.frame_subframe = scene.frame_current, scene.frame_subframe
    to_scene = turn / scene.unit_settings.scale_length
    shapes = [surface.vertices for surface in surfaces] + [facets.above_skin(points, normals).reshape(-1, 3)]
    for thing, vertices in zip([*stage.hands, stage.facets], shapes, strict=True):
        thing.data.vertices.foreach_set("co", (vertices @ to_scene).ravel())
        thing.data.update()
    found = facets.fields(probe.bake(own, stage.facets) @ worlds.rec709_from_scene().T, normals)
    return found.reshape(len(hands), FINE_POINTS, 4, 3).astype("<f4")


def _new_stage(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, surfaces: Sequence[Surface]) -> _Stage:
    made: list[Any] = []
    try:
        return _built(scene, layer, surfaces, made)
    finally:
        for _, thing in made:
            thing[_MARK] = True  # for `clear`
            thing.is_runtime_data = True  # no file that is saved meanwhile has it


def _built(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, surfaces: Sequence[Surface], made: list[Any]) -> _Stage:
    """made: see `probe.new_scene`"""
    own = probe.new_scene(scene, None, made, SAMPLES)
    white = probe.new_material("ShaderNodeBsdfDiffuse", (1.0, 1.0, 1.0, 1.0), made)
    skin = probe.new_material("ShaderNodeBsdfDiffuse", stand_ins.SKIN_RGBA, made)
    above = probe.new_facets(np.zeros((facets.LOOKS * FINE_POINTS * len(surfaces), 3, 3)), made)
    above.data.materials.append(white)
    for name in _SEEN_BY:
        setattr(above, f"visible_{name}", False)
    hands = []
    for surface in surfaces:
        mesh = bpy.data.meshes.new(probe.NAME)
        made.append((bpy.data.meshes, mesh))
        mesh.from_pydata(surface.vertices, [], surface.faces)
        mesh.materials.append(skin)
        hands.append(bpy.data.objects.new(probe.NAME, mesh))
        made.append((bpy.data.objects, hands[-1]))
    there = armature.rendered_at_any_frame(layer, _is_there)
    of_hands = armature.rendered_at_any_frame(layer, armature.is_any_hand)
    there = [_linked(thing, above, hands, of_hands, made) if thing.type == "LIGHT" else thing for thing in there]
    for thing in (above, *hands, *there):
        own.collection.objects.link(thing)
    return _Stage(own, hands, above)


def _is_there(thing: bpy.types.Object) -> bool:
    """Whether an object shines, throws light back or takes it, or instances what does; hands are there themselves."""
    return worlds.is_surface(thing) or thing.type == "LIGHT" or (thing.is_instancer and armature.STAND_IN not in thing)


def _linked(
    lamp: bpy.types.Object,
    above: bpy.types.Object,
    surfaces: Sequence[bpy.types.Object],
    hands: Sequence[bpy.types.Object],
    made: list[Any],
) -> bpy.types.Object:
    """A lamp that lights facets and surfaces, and is shaded by surfaces, as its light linking has it with the hands; a
    copy where that is to be said."""
    linking = lamp.light_linking
    receivers = _with_ours(linking.receiver_collection, (above, *surfaces), hands, made)
    blockers = _with_ours(linking.blocker_collection, surfaces, hands, made)
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
    hands: Sequence[bpy.types.Object],
    made: list[Any],
) -> bpy.types.Collection | None:
    """Receivers or blockers of a lamp, with what is ours as the hands are; a copy where that is to be said."""
    if linked is None:
        return None
    is_wanted = lamps.lights_any(linked, hands)
    states = {how.light_linking.link_state for how in (*linked.collection_objects, *linked.collection_children)}
    if is_wanted != ("INCLUDE" in states):
        return linked
    copy = linked.copy()
    made.append((bpy.data.collections, copy))
    copy.name = probe.NAME
    for thing in ours:
        copy.objects.link(thing)
        copy.collection_objects[-1].light_linking.link_state = "INCLUDE" if is_wanted else "EXCLUDE"
    return copy
