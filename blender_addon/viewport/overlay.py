# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's picture in Solid and Material Preview: a draw handler after the scene, tested against its depth."""

from __future__ import annotations

from typing import Any

import bpy

from . import drawing, views

_handle: Any = None


def draw() -> None:
    """Called by Blender for every 3D view that it draws."""
    drawing.free_unwanted()  # also where nothing is drawn any more
    context = bpy.context
    if views.draws(context.space_data, context.scene, views.SOLID):
        views.draw(context, context.evaluated_depsgraph_get, views.SOLID)
    else:
        views.may_draw_again(context.region.as_pointer(), views.SOLID)


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
