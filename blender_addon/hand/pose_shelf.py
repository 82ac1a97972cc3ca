# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's shelf of pose assets below the 3D views: there once a view was drawn in pose mode, so a timer tries."""

from __future__ import annotations

import bpy

from .. import clock
from ..core import limits

_left = 0


def show() -> None:
    """Shows the shelf in the views of the screen that is looked at, as soon as they have one."""
    global _left
    if bpy.app.background:
        return
    _left = limits.SHELF_TRIES
    if not bpy.app.timers.is_registered(_try):
        bpy.app.timers.register(_try, first_interval=limits.SHELF_S)


def register() -> None:
    """Nothing happens before it is asked for."""


def unregister() -> None:
    """Stops trying."""
    if bpy.app.timers.is_registered(_try):
        bpy.app.timers.unregister(_try)


@clock.guarded(None)
def _try() -> float | None:
    global _left
    _left -= 1
    spaces = [
        area.spaces.active
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "VIEW_3D"
    ]
    ready = [space for space in spaces if not space.is_property_readonly("show_region_asset_shelf")]
    for space in ready:
        space.show_region_asset_shelf = True
    return limits.SHELF_S if len(ready) < len(spaces) and _left > 0 else None
