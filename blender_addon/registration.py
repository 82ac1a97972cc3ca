# SPDX-License-Identifier: GPL-3.0-or-later
"""What the extension adds to Blender, in one ordered list of modules; taken away in the opposite order.

Every module of the list has `register()` and `unregister()`. Both may be called twice: a reload that failed half-way
must not leave Blender with half an extension that cannot be removed.
"""

from __future__ import annotations

import atexit
from types import ModuleType

import bpy

from . import cli_command, preferences, properties, render_engine, runtime
from .bridge import (
    appended,
    avatar_files,
    cache_player,
    cards,
    guard,
    job_watch,
    kept,
    left_out,
    pose_pictures,
    pose_shelf,
    sync,
    usd_hook,
)
from .operators import (
    bake,
    bone_map,
    combine,
    engine,
    export,
    finger_controls,
    hand,
    help_page,
    motion,
    picture,
    pose,
    track,
    training,
)
from .panels import advanced, bones, output, presets, quality, render_settings
from .panels import hand as hand_panel
from .panels import motion as motion_panel
from .panels import picture as picture_panels
from .panels import pose as pose_panels
from .panels import training as training_panels

# a module comes after those whose classes it uses
MODULES: tuple[ModuleType, ...] = (
    preferences,
    properties,
    runtime,
    *(pose_pictures, pose_shelf, job_watch, kept, avatar_files, cards, usd_hook, cache_player, appended),
    sync,
    guard,
    left_out,
    render_engine,
    cli_command,
    *(help_page, engine, hand, bone_map, pose, finger_controls, motion, track, picture),
    *(combine, bake, export, training),
    presets,
    *(hand_panel, bones, pose_panels, motion_panel, picture_panels, quality, output, training_panels, advanced),
    render_settings,
)


def is_registered() -> bool:
    """Whether everything is there."""
    return render_engine.JGHandRenderEngine.is_registered


def register() -> None:
    """Adds everything; when a module fails, what was added before it is taken away again and the error goes on."""
    done: list[ModuleType] = []
    try:
        for module in MODULES:
            module.register()
            done.append(module)
    except Exception:
        for module in reversed(done):
            module.unregister()
        raise
    atexit.register(_at_exit)


def unregister() -> None:
    """Takes everything away."""
    atexit.unregister(_at_exit)
    for module in reversed(MODULES):
        module.unregister()


def _at_exit() -> None:
    """Blender as a module disables no extension at its end, and the one of 4.5 hangs there while a handler or a timer
    is left. Blender itself has disabled it by then, or has too little left of its data to do it now."""
    if bpy.app.module:
        unregister()
