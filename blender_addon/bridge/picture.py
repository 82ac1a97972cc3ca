# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's picture in Solid and Material Preview: a draw handler after the scene, tested against its depth."""

from __future__ import annotations

from typing import Any

import bpy

from . import rendering, views

_SHADINGS = ("SOLID", "MATERIAL")
_handle: Any = None


def draw() -> None:
    """Called by Blender for every 3D view that it draws."""
    context = bpy.context
    space = context.space_data
    if space.shading.type not in _SHADINGS or not context.scene.jghand.show_in_viewport:
        return
    if rendering.now():
        views.show_again(context, views.SOLID)
    else:
        views.show(context, context.evaluated_depsgraph_get(), views.SOLID)


def install() -> None:
    """Begins to draw; once, however often it is called."""
    global _handle
    if _handle is None:
        _handle = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", "POST_VIEW")


def remove() -> None:
    """Ends it."""
    global _handle
    if _handle is not None:
        bpy.types.SpaceView3D.draw_handler_remove(_handle, "WINDOW")
        _handle = None
