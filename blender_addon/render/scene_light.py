# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that a scene throws on its hands: its lamps and its world, for renders and for 3D views.

light = in_view(depsgraph, space, hands)    None: hands are shown in the light of their captures

Worlds whose nodes do not tell their light are measured by `tend`, which the timer calls, and before frames are rendered
without a window.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import bpy
import numpy as np

from ..core.stand_in import POINTS, points_on, surface_at
from ..core.view import LIGHT_FROM_WORLD, HandInSpace, SceneLight
from ..errors import JGHandFailure
from ..hand import instances
from . import lamps, scene_shadows, studio, worlds
from .lamps import SceneLamps
from .worlds import Reading

# the last light of each set of lamps and world: one that does not change is not put together anew at each draw
_made: dict[tuple[str, str], SceneLight] = {}
# and the last lights with what things take of them, of some views
_shaded: dict[tuple[object, ...], SceneLight | None] = {}
_SHADED_MAX = 8
# sentences about what of the light of the last render, or view, is not honored
_warnings: tuple[str, ...] = ()
# seconds for which a world rests before it is measured: nothing while somebody turns a knob of it
_REST_S = 0.3
# the world that is to be measured, and since when, on the clock of time.monotonic()
_BLACK = Reading(None)
_stale, _stale_since_s = _BLACK, 0.0
# worlds that cannot be measured, and why
_unmeasured: dict[str, str] = {}


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
        around = studio.light_of(space)
        if around is None:
            return None
        world = Reading(around)
    return _together(lamps.in_view(depsgraph, space, hands), world)


def of_render(depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object]) -> SceneLight | None:
    """What lights hands in a render."""
    if not is_chosen(depsgraph.scene):
        return None
    return _together(lamps.lamps_of(depsgraph, hands), _world(depsgraph, hands))


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
    return scene_shadows.left_of_lamps(*points_on(surface), light.lamps, depsgraph)


def shaded_in_view(
    light: SceneLight | None, hands: Sequence[HandInSpace], depsgraph: bpy.types.Depsgraph
) -> SceneLight | None:
    """The same in a 3D view, kept between two draws."""
    if light is None:
        return None
    key: tuple[object, ...] = (light.key, scene_shadows.edits(), depsgraph.scene.session_uid, depsgraph.view_layer.name)
    key += tuple((hand.handedness, hand.joints_world_m.tobytes()) for hand in hands)
    if key not in _shaded:
        if len(_shaded) >= _SHADED_MAX:
            _shaded.clear()
        _shaded[key] = shaded(light, hands, depsgraph)
    return _shaded[key]


def is_chosen(scene: bpy.types.Scene) -> bool:
    """Whether a scene lights its hands."""
    return scene.jghand.light == "SCENE"


def warnings() -> tuple[str, ...]:
    """Sentences about what of the light that hands were shown in last is not honored."""
    return _warnings


def tend() -> bool:
    """For the timer: measures the world of the views, where that is due; says whether anything is new."""
    if studio.tend():
        return True
    if not _stale.stale or _stale.stale in _unmeasured or time.monotonic() - _stale_since_s < _REST_S:
        return False
    _measure(bpy.context.evaluated_depsgraph_get(), _stale.place)
    return True


def measure(depsgraph: bpy.types.Depsgraph) -> None:
    """Measures the world of a scene that lights its hands, where that is stale. On the main thread, in no handler."""
    if is_chosen(depsgraph.scene):
        _measure(depsgraph, worlds.place_of(depsgraph, instances.evaluated_sources(depsgraph)))


def _measure(depsgraph: bpy.types.Depsgraph, place: worlds.Place | None) -> None:
    global _stale
    _stale = _BLACK
    try:
        worlds.update(depsgraph, place)
    except JGHandFailure as failure:
        _unmeasured[worlds.world_of(depsgraph, place).stale] = str(failure)


def forget() -> None:
    """Another file, or everything in it may be another."""
    lamps.forget()
    worlds.forget()
    scene_shadows.forget()
    _made.clear()
    _unmeasured.clear()


def _world(depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object]) -> Reading:
    """The world of a scene; where it is stale `tend` sees to it."""
    global _stale, _stale_since_s
    reading = worlds.world_of(depsgraph, worlds.place_of(depsgraph, hands))
    if reading.stale != _stale.stale:
        _stale, _stale_since_s = reading, time.monotonic()
    return reading


def _together(found: SceneLamps, world: Reading) -> SceneLight:
    global _warnings
    of_world = [_unmeasured[world.stale]] if world.stale in _unmeasured else map(str, world.failures)
    _warnings = (*found.warnings, *of_world)
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
