# SPDX-License-Identifier: GPL-3.0-or-later
"""What panels show of disks and of evaluated scenes: looked up on a timer and kept, for panels are drawn at every frame
of playback. Kept are values; a look is given names and numbers, never what belongs to Blender's data.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, TypeVar

import bpy

from .. import clock, ui
from ..core import limits
from ..ui import redraw

T = TypeVar("T")
_Key = tuple[Callable[..., Any], int, tuple[Hashable, ...]]

_values: dict[_Key, Any] = {}
_asked: set[_Key] = set()


def kept(context: bpy.types.Context, look: Callable[..., T], *about: Hashable) -> T | None:
    """What `look(context, *about)` found last for this scene, None before the first time; asks for a new look. Without
    a window, where timers never fire, it looks at once."""
    if bpy.app.background:
        return look(context, *about)
    key = (look, context.scene.session_uid, about)
    _asked.add(key)
    if not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=limits.PANEL_LOOK_S if key in _values else 0.0)
    return _values.get(key)


def register() -> None:
    """Nothing is looked at before a panel asks."""


def unregister() -> None:
    """Forgets everything."""
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    _values.clear()
    _asked.clear()


@clock.guarded(None)
def _tick() -> None:
    """One look at all that was asked for since the last one; what nobody asks for any more is forgotten, and what
    cannot be looked at is not known. Panels that show something new are drawn, and ask again."""
    asked = set(_asked)
    _asked.clear()
    before = dict(_values)
    _values.clear()
    for key in asked:
        look, scene_uid, about = key
        with ui.in_a_window(scene_uid) as context:
            if context.scene.session_uid == scene_uid:
                try:
                    _values[key] = look(context, *about)
                except Exception as error:  # the other looks go on
                    clock.tell_once(error)
    if _values != before:
        redraw()
