# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that a scene throws on its hands: its lamps and its world, for renders and for 3D views.

light = in_view(depsgraph, space, hands)    None: hands are shown in the light of their captures

Worlds whose nodes do not tell their light are measured by `tend`, which the timer calls, for a render in a window while
it waits, and in a Blender without one before each frame that is rendered.
"""

from __future__ import annotations

import io
import json
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ..core.files import write_whole
from ..core.pacing import SETTLE_S
from ..core.stand_in import POINTS, points_on, surface_at
from ..core.view import LIGHT_FROM_WORLD, HandInSpace, SceneLight
from ..errors import JGHandFailure
from ..hand import avatar_files, seen_hands
from . import handover, lamps, probe, scene_shadows, worlds
from .lamps import SceneLamps
from .properties import LIGHT_OF_HANDS
from .worlds import Reading

# the last light of each set of lamps and world: one that does not change is not put together anew at each draw
_made: dict[tuple[str, str], SceneLight] = {}
# views whose last light with what things take of it is kept, by their place at the link
_SHADED_MAX = 8
# sentences about what of the light of the last render, or view, is not honored
warnings: tuple[str, ...] = ()
# seconds for which a world rests before it is measured: nothing while somebody turns a knob of it
_REST_S = 0.3


class _Stale(NamedTuple):
    """What is to be measured, of which view layer, and since when, on the clock of time.monotonic()."""

    reading: Reading
    scene_uid: int
    layer: str
    since_s: float


_stale: _Stale | None = None
# worlds that could not be measured, with or without Cycles, and why
_unmeasured: dict[tuple[str, bool], JGHandFailure] = {}


@dataclass
class _Shaded:
    """What a view shows. key: state of light, hands and things that it was looked for · shape: lamps and hands that it
    has · light: with what things take · wanted: the state of now, since_s on the clock of time.monotonic() · is_told:
    whether the timer had it drawn after a rest"""

    key: tuple[object, ...]
    shape: tuple[object, ...]
    light: SceneLight
    wanted: tuple[object, ...]
    since_s: float
    is_told: bool = False


_shaded: dict[str, _Shaded] = {}


def in_view(
    depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D, hands: Sequence[bpy.types.Object]
) -> SceneLight | None:
    """What lights hands in a 3D view: Solid has none, Material Preview without the scene's world has its HDRI."""
    if not is_chosen(depsgraph.scene):
        return None
    world = _world(depsgraph, hands)  # also in Solid: a render may come next
    if space.shading.type == "SOLID":
        return None
    if space.shading.type == "MATERIAL" and not space.shading.use_scene_world:
        around = worlds.hdri_light(space)
        if around is None:
            return None
        world = Reading(around)
    return _together(lamps.in_view(depsgraph, space, hands), world)


def of_render(
    depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object], is_canceled: Callable[[], bool] = lambda: False
) -> SceneLight | None:
    """What lights hands in a render; in a window a stale world is measured meanwhile. Raises JGHandFailure
    (world_not_measured, world_bake, no_cycles, no_world_image, canceled) where the world's light is not known."""
    if not is_chosen(depsgraph.scene):
        return None
    world = _world(depsgraph, hands)
    if world.stale and handover.is_possible():
        handover.do(partial(_measure, depsgraph, world), is_canceled)
        world = _world(depsgraph, hands)
    light = _together(lamps.lamps_of(depsgraph, hands), world)
    if world.failures:
        raise _unmeasured.get(_attempt(world.stale), world.failures[0])
    return light


def shaded(light: SceneLight | None, hands: Sequence[HandInSpace], depsgraph: bpy.types.Depsgraph) -> SceneLight | None:
    """A light, less what the things of the scene take of its lamps on these hands."""
    if light is None or not light.lamps or not hands:
        return light
    left = np.stack([_left(hand, light, depsgraph) for hand in hands])
    return replace(light, left=left) if left.min() < 255 else light


def _left(hand: HandInSpace, light: SceneLight, depsgraph: bpy.types.Depsgraph) -> np.ndarray:
    """(lamps, POINTS) uint8 what things leave on the skin of a hand; all of it on one whose joints have no palm."""
    try:
        surface = surface_at(hand.joints_world_m @ LIGHT_FROM_WORLD[:3, :3].T, hand.handedness)
    except JGHandFailure:  # the engine says so, and draws it nevertheless
        return np.full((len(light.lamps), POINTS), 255, np.uint8)
    near = scene_shadows.beside_on_hands()
    return scene_shadows.left_of_lamps(*points_on(surface), near, light.lamps, depsgraph)


def shaded_in_view(
    light: SceneLight | None, hands: Sequence[HandInSpace], depsgraph: bpy.types.Depsgraph, view: str
) -> SceneLight | None:
    """The same in a 3D view, kept between two draws. While somebody poses, plays or moves lamps, hands keep the shadows
    that they have: rays take longer than a frame may."""
    if light is None or not light.lamps or not hands:
        return light
    key: tuple[object, ...] = (light.key, scene_shadows.edits, depsgraph.scene.session_uid, depsgraph.view_layer.name)
    key += tuple((hand.handedness, hand.joints_world_m.tobytes()) for hand in hands)
    shape = (len(light.lamps), *(hand.handedness for hand in hands))
    last, now_s = _shaded.get(view), time.monotonic()
    if last is not None and last.key == key:
        last.wanted = key
        return last.light
    if last is not None and last.shape == shape:
        if last.wanted != key:
            last.wanted, last.since_s, last.is_told = key, now_s, False
        if now_s - last.since_s < SETTLE_S:
            return replace(light, left=last.light.left)
    seen = shaded(light, hands, depsgraph)
    assert seen is not None  # as light is
    if len(_shaded) >= _SHADED_MAX:
        _shaded.clear()
    _shaded[view] = _Shaded(key, shape, seen, key, now_s)
    return seen


def _rested() -> bool:
    """Whether a view keeps shadows of another state, which now rests: said once, as the view may be gone."""
    now_s = time.monotonic()
    due = [
        each
        for each in _shaded.values()
        if each.wanted != each.key and not each.is_told and now_s - each.since_s >= SETTLE_S
    ]
    for each in due:
        each.is_told = True
    return bool(due)


def is_chosen(scene: bpy.types.Scene) -> bool:
    return scene.jghand.light == "SCENE"


def follow(scene: bpy.types.Scene, given: Collection[bpy.types.Object]) -> None:
    """Hands were given their avatars: where these are all hands of a scene, and no artist chose its light, that follows
    whether they answer the scene's."""
    is_free = LIGHT_OF_HANDS in scene or not scene.jghand.is_property_set("light")
    hands = (hand for thing in scene.objects for hand in seen_hands.hands_below(thing))
    if is_free and scene.is_editable and all(hand in given for hand in hands):
        scene.jghand.light = "SCENE" if all(map(_answers_light, given)) else "CAPTURE"
        scene[LIGHT_OF_HANDS] = True


@persistent
def on_import(imported: bpy.types.BlendImportContext, *_: Any) -> None:
    """Data-blocks were linked or appended: hands among them are added ones."""
    came = [each.id for each in imported.import_items]
    objects = [thing for thing in came if isinstance(thing, bpy.types.Object)]
    for collection in came:  # of a linked one no object is named
        objects += collection.all_objects if isinstance(collection, bpy.types.Collection) else ()
    hands = [hand for thing in objects for hand in seen_hands.hands_below(thing)]
    if hands and bpy.context.scene is not None:
        follow(bpy.context.scene, hands)


def _answers_light(hand: bpy.types.Object) -> bool:
    try:
        return avatar_files.card_of(seen_hands.avatar_of(hand)).answers_light
    except JGHandFailure:  # the panel of hands says why
        return False


def tend() -> bool:
    """For the timer: measures the world of the views, where that is due; says whether views are to be drawn."""
    if _rested() or worlds.read_hdri():
        return True
    if _stale is None or time.monotonic() - _stale.since_s < _REST_S:
        return False
    reading, uid, name, _ = _stale
    if _attempt(reading.stale) in _unmeasured:
        return False
    scene = next((each for each in bpy.data.scenes if each.session_uid == uid), None)
    layer = scene.view_layers.get(name) if scene is not None else None
    if layer is None or layer.depsgraph is None:  # deleted, or shown nowhere any more
        _forget_stale()
        return False
    return _measure(layer.depsgraph, reading)


def measure(depsgraph: bpy.types.Depsgraph) -> None:
    """Measures the world of a scene that lights its hands, where that is stale. On the main thread; of handlers only
    in render_pre."""
    if is_chosen(depsgraph.scene):
        reading = _world(depsgraph, seen_hands.evaluated_sources(depsgraph))
        if reading.stale:
            _measure(depsgraph, reading)


def save(depsgraph: bpy.types.Depsgraph, path: Path) -> None:
    """Writes the light of a scene that lights its hands as a file for the engine, with the picture of its world beside
    it. JGHandFailure as `of_render`, and cannot_write, disk_full."""
    measure(depsgraph)
    light = of_render(depsgraph, seen_hands.evaluated_sources(depsgraph))
    assert light is not None  # who asks has seen that it is chosen
    record = {"format": "jghand-light", "version": 1, **light.record()}
    if light.world is not None and light.picture is not None:
        content, picture = io.BytesIO(), path.with_suffix(".npy")
        np.save(content, light.picture)
        write_whole(picture, content.getvalue())
        record["world"] = {"picture": picture.name, "env_from_world": light.world["env_from_world"]}
    write_whole(path, json.dumps(record, indent=1).encode())


def _measure(depsgraph: bpy.types.Depsgraph, stale: Reading) -> bool:
    """Says whether anything is new. What failed is tried again for a render, and when Cycles is switched on or off."""
    _forget_stale()
    _unmeasured.pop(_attempt(stale.stale), None)
    try:
        return worlds.update(depsgraph, stale.place)
    except JGHandFailure as failure:
        _unmeasured[_attempt(stale.stale)] = failure
        return True


def _attempt(stale: str) -> tuple[str, bool]:
    return stale, probe.is_possible()


def _forget_stale() -> None:
    global _stale
    _stale = None


def forget() -> None:
    """Another file, or everything in it may be another."""
    lamps.forget()
    worlds.forget()
    scene_shadows.forget()
    _made.clear()
    _shaded.clear()
    _unmeasured.clear()
    _forget_stale()


def _world(depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object]) -> Reading:
    """The world of a scene; where it is stale `tend` sees to it."""
    global _stale
    reading = worlds.world_of(depsgraph, worlds.place_of(depsgraph, hands))
    if not reading.stale:
        return reading
    of = depsgraph.scene.session_uid, depsgraph.view_layer.name
    if _stale is None or (_stale.reading.stale, _stale.scene_uid, _stale.layer) != (reading.stale, *of):
        _stale = _Stale(reading, *of, time.monotonic())
    return reading


def _together(found: SceneLamps, world: Reading) -> SceneLight:
    global warnings
    known = _unmeasured.get(_attempt(world.stale)) if world.stale else None
    warnings = (*found.warnings, *map(str, world.failures if known is None else [known]))
    if world.for_cameras:
        warnings += ("The world shows to the camera alone and lights no hands; let diffuse rays see it",)
    around = world.light
    key = (found.key, "" if around is None else repr((around.record, around.suns)))
    if key not in _made:
        _made.clear()
        _made[key] = (
            SceneLight(found.lamps)
            if around is None
            else SceneLight((*found.lamps, *around.suns), around.record, around.radiance)
        )
    return _made[key]
