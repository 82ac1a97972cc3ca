# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether Blender renders now. The handlers of `sync` say so: `is_job_running` is false for `blender -b -a`."""

from __future__ import annotations

import bpy

_rendering = False


def begin() -> None:
    """A render begins."""
    global _rendering
    _rendering = True


def end() -> None:
    """A render is over, or was given up."""
    global _rendering
    _rendering = False


def now() -> bool:
    """Whether a picture or an animation is rendered now."""
    return _rendering


def check() -> bool:
    """The same, asked while Blender's main thread is free in a window: a render that ended without a word is over."""
    if _rendering and not bpy.app.is_job_running("RENDER"):
        end()
    return _rendering
