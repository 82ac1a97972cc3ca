# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension adds to Blender: classes, then what is no class, in two ordered lists.

A module of the first list has `CLASSES`; one of the second what it needs of these:

    SETTINGS       (type of Blender's, class of what is saved with it as `jghand`)
    MENUS          (menu of Blender's, what draws behind its entries)
    APP_HANDLERS   (name in bpy.app.handlers, function)
    register(), unregister()
"""

from __future__ import annotations

import atexit
from types import ModuleType

import bpy

from . import folders, preferences
from .export import ops as export_ops
from .export import panel as export_panel
from .export import usd_hook
from .hand import ops as hand_ops
from .hand import ops_motion, ops_pose, stand_ins
from .hand import panel as hand_panel
from .hand import properties as hand_properties
from .render import command, preview, rendering
from .render import engine as render_engine
from .render import ops as render_ops
from .render import panel as render_panel
from .render import properties as scene_properties
from .renderer import ops as renderer_ops
from .renderer import runtime
from .train import ops as train_ops
from .train import panel as train_panel
from .viewport import handlers

# a class comes after those that it uses; Blender shows panels in the order in which they come
WITH_CLASSES = (
    *(preferences, hand_properties, scene_properties, render_engine, renderer_ops),
    *(hand_ops, ops_pose, ops_motion),
    *(render_ops, preview, export_ops, train_ops),
    *(hand_panel, render_panel, export_panel, train_panel),
)
# handlers, timers, menus, and what is forgotten at the end
_WITH_HOOKS: tuple[ModuleType, ...] = (
    *(preferences, hand_properties, scene_properties, runtime, usd_hook),
    *(folders, handlers, rendering, render_engine, preview, command, hand_ops, ops_motion, stand_ins),
)
_add_classes, _remove_classes = bpy.utils.register_classes_factory(
    [each for module in WITH_CLASSES for each in module.CLASSES]
)


def is_registered() -> bool:
    return render_engine.JGHandRenderEngine.is_registered


def register() -> None:
    if is_registered():
        return
    _add_classes()
    for module in _WITH_HOOKS:
        for owner, settings in getattr(module, "SETTINGS", ()):
            owner.jghand = bpy.props.PointerProperty(type=settings, override=hand_properties.OVERRIDABLE)
        for menu, draw in getattr(module, "MENUS", ()):
            menu.append(draw)
        for name, function in getattr(module, "APP_HANDLERS", ()):
            getattr(bpy.app.handlers, name).append(function)
        if hasattr(module, "register"):
            module.register()
    atexit.register(_at_exit)


def unregister() -> None:
    """Takes everything away, where it is there; what files hold stays in them."""
    if not is_registered():
        return
    atexit.unregister(_at_exit)
    for module in reversed(_WITH_HOOKS):
        if hasattr(module, "unregister"):
            module.unregister()
        for name, function in getattr(module, "APP_HANDLERS", ()):
            if function in (there := getattr(bpy.app.handlers, name)):
                there.remove(function)
        for menu, draw in getattr(module, "MENUS", ()):
            menu.remove(draw)
        for owner, _ in getattr(module, "SETTINGS", ()):
            del owner.jghand
    _remove_classes()


def _at_exit() -> None:
    """Blender as a module disables no extension at its end, and the one of 4.5 hangs there while a handler or a timer
    is left. Blender itself has disabled it by then, or has too little left of its data to do it now."""
    if bpy.app.module:
        unregister()
