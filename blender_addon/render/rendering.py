# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether Blender renders hands now, so that the engine belongs to the render and views leave it alone.

The handlers of `sync` say so: `is_job_running` is false for `blender -b -a`. A render of Cycles or EEVEE alone needs no
engine of ours: views go on beside it.
"""

from __future__ import annotations

import math
import time

import bpy

from . import composite
from .engine_name import ENGINE

_began_s = math.inf


def needs_engine(scene: bpy.types.Scene) -> bool:
    """Whether a render of this scene draws hands, itself or through a scene of its hands that is combined with it."""
    return scene.render.engine == ENGINE or composite.hands_scene_of(scene) is not None


def begin() -> None:
    """A render of hands begins."""
    global _began_s
    _began_s = time.monotonic()


def end() -> None:
    """A render is over, or was given up."""
    global _began_s
    _began_s = math.inf


def now() -> bool:
    """Whether a picture or an animation with hands is rendered now."""
    return _began_s < math.inf


def lasts_s() -> float:
    """For how many seconds; below 0 while nothing is rendered."""
    return time.monotonic() - _began_s


def check() -> bool:
    """The same, asked while Blender's main thread is free in a window: a render that ended without a word is over."""
    if now() and not bpy.app.is_job_running("RENDER"):
        end()
    return now()
