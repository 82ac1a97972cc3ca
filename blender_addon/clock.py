# SPDX-License-Identifier: GPL-3.0-or-later
"""The timer of Blender's that drives pictures: it calls one function, which says when it wants to be called again. And
what all timers of the extension share: those of jobs, of what panels show, of pose pictures and of the pose shelf.

Timers never fire in `blender -b` nor in the bpy module: what they do must not matter there. Blender drops a timer that
raised, so that one mistake would end all that the extension shows: it is printed, and the timer goes on.
Source: BLENDER 5.
"""

from __future__ import annotations

import functools
import time
import traceback
from collections.abc import Callable

import bpy

# how often the timer looks when nothing is open. Blender's own loop sleeps 5 ms between looks
IDLE_TICK_S = 0.1

_tick: Callable[[], float] | None = None
_next_s = 0.0
_inside = False
# mistakes that were told already: a tick makes the same one ten times a second
_told: set[tuple[type[Exception], str]] = set()


def guarded(again_s: float | None) -> Callable[[Callable[[], float | None]], Callable[[], float | None]]:
    """Makes a timer survive its mistakes: each is printed once, and it is called again after so many seconds; None: it
    rests until it is asked for again."""

    def decorate(tick: Callable[[], float | None]) -> Callable[[], float | None]:
        @functools.wraps(tick)
        def call() -> float | None:
            try:
                return tick()
            except Exception as error:  # whatever it is: Blender would drop the timer
                tell_once(error)
                return again_s

        return call

    return decorate


def use(tick: Callable[[], float]) -> None:
    """What is called, on the main thread, once somebody has hastened it; it returns the seconds until the next call. A
    session without a hand has no timer."""
    global _tick
    stop()
    _told.clear()
    _tick = tick


def stop() -> None:
    """Ends it; may be called when there is none."""
    global _tick
    _tick = None
    if bpy.app.timers.is_registered(_call):
        bpy.app.timers.unregister(_call)


def hasten(seconds: float) -> None:
    """Makes sure that the next call comes within so many seconds."""
    if _tick is None or _inside:
        return
    if not runs():
        _schedule(seconds)
    elif time.monotonic() + seconds < _next_s:
        bpy.app.timers.unregister(_call)
        _schedule(seconds)


def runs() -> bool:
    """Whether it was hastened, and Blender still has it."""
    return _tick is not None and bpy.app.timers.is_registered(_call)


def _schedule(seconds: float) -> None:
    global _next_s
    _next_s = time.monotonic() + seconds
    bpy.app.timers.register(_call, first_interval=seconds, persistent=True)


@guarded(IDLE_TICK_S)
def _call() -> float | None:
    global _next_s, _inside
    if _tick is None:
        return None
    _inside, seconds = True, IDLE_TICK_S
    try:
        seconds = _tick()
    finally:
        _inside, _next_s = False, time.monotonic() + seconds
    return seconds


def tell_once(error: Exception) -> None:
    """Prints a mistake with its trace, unless it was told already."""
    kind = type(error), str(error)
    if kind not in _told:
        _told.add(kind)
        traceback.print_exception(error)
