# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that a scene throws on its hands: its lamps and its world, for renders and for 3D views.

light = in_view(depsgraph, space, hands)    None: hands are shown in the light of their captures
"""

from __future__ import annotations

from collections.abc import Sequence

import bpy

from ..core.view import SceneLight
from . import lamps, worlds
from .lamps import SceneLamps
from .worlds import Reading

# the last light of each set of lamps and world: one that does not change is not put together anew at each draw
_made: dict[tuple[str, str], SceneLight] = {}
# sentences about what of the light of the last render, or view, is not honored
_warnings: tuple[str, ...] = ()


def in_view(
    depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D, hands: Sequence[bpy.types.Object]
) -> SceneLight | None:
    """What lights hands in a 3D view: Solid, and Material Preview without the scene's lights or world, have none."""
    if not is_chosen(depsgraph.scene) or not lamps.uses_scene_lights(space) or not _uses_world(space):
        return None
    return _together(lamps.in_view(depsgraph, space, hands), worlds.world_of(depsgraph))


def of_render(depsgraph: bpy.types.Depsgraph, hands: Sequence[bpy.types.Object]) -> SceneLight | None:
    """What lights hands in a render."""
    if not is_chosen(depsgraph.scene):
        return None
    return _together(lamps.lamps_of(depsgraph, hands), worlds.world_of(depsgraph))


def is_chosen(scene: bpy.types.Scene) -> bool:
    """Whether a scene lights its hands."""
    return scene.jghand.light == "SCENE"


def warnings() -> tuple[str, ...]:
    """Sentences about what of the light that hands were shown in last is not honored."""
    return _warnings


def _uses_world(space: bpy.types.SpaceView3D) -> bool:
    return space.shading.type == "RENDERED" or space.shading.use_scene_world


def _together(found: SceneLamps, world: Reading) -> SceneLight:
    global _warnings
    _warnings = (*found.warnings, *map(str, world.failures))
    around = world.light
    key = (found.key, "" if around is None else around.key)
    if key not in _made:
        _made.clear()
        _made[key] = (
            SceneLight(found.lamps)
            if around is None
            else SceneLight((*found.lamps, *around.suns), around.record, around.radiance)
        )
    return _made[key]
