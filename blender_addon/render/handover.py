# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render in a window has done on Blender's main thread, which alone may bake, and what is left behind by it.

    found = do(work, is_canceled)      on the render's thread, which waits for the timer
    put_away(made)                     on the main thread, at any time

What is removed while Blender renders ends it, what is made does not (run, 5.2.2; BLENDER 8.2): so what was made for a
bake stays until no render goes on.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy

from .. import clock
from ..errors import JGHandFailure

# how often a render looks whether it was canceled, seconds
_POLL_S = 0.05
# what bakes make
_KINDS = ("scenes", "objects", "meshes", "materials", "collections", "worlds")
# custom property of all that: names alone may be an artist's
_MARK = "jghand_bake"


@dataclass
class _Errand:
    """What a render waits for. is_canceled: whether it was given up; found: what `work` returned, or failure"""

    work: Callable[[], Any]
    is_canceled: Callable[[], bool]
    found: Any = None
    failure: Exception | None = None
    is_done: threading.Event = field(default_factory=threading.Event)


_errand: _Errand | None = None
# whether anything was left that is to be taken away
_is_untidy = False


def is_blender_busy() -> bool:
    """Whether Blender renders or bakes anything beside its free main thread: what adds or removes data must wait, for
    that can end Blender."""
    return any(map(bpy.app.is_job_running, ("RENDER", "OBJECT_BAKE")))


def is_possible() -> bool:
    """Whether this is the thread of a render, and the timer there."""
    return threading.current_thread() is not threading.main_thread() and clock.runs()


def do(work: Callable[[], Any], is_canceled: Callable[[], bool]) -> Any:
    """What `work` returns or raises. JGHandFailure: canceled."""
    global _errand
    errand = _errand = _Errand(work, is_canceled)
    while not errand.is_done.wait(_POLL_S):
        if is_canceled():
            _errand = None
            raise JGHandFailure("canceled")
    if errand.failure is not None:
        raise errand.failure
    return errand.found


def tend() -> bool:
    """For the timer: does what a render waits for, and tidies up after the last one, which it says."""
    global _errand
    errand, _errand = _errand, None
    if errand is not None:
        _run(errand)
    elif _is_untidy and not is_blender_busy():
        clear()
        return True
    return False


def _run(errand: _Errand) -> None:
    """A failure, whatever it is, ends the wait of the render, too. Nothing is done after Esc, which a bake makes
    Blender forget: it would write an empty frame and go on."""
    try:
        if errand.is_canceled():
            raise JGHandFailure("canceled")
        errand.found = errand.work()
    except Exception as error:
        errand.failure = error
    finally:
        errand.is_done.set()


def put_away(made: Sequence[tuple[Any, Any]]) -> None:
    """Removes what was made, (collection of bpy.data, data-block) each, or leaves it."""
    if not is_blender_busy():
        for kind, thing in reversed(made):
            kind.remove(thing)
        return
    leave(made)
    for _, scene in made:
        if isinstance(scene, bpy.types.Scene):  # evaluated meshes of every frame would be kept
            for thing in list(scene.collection.objects):
                scene.collection.objects.unlink(thing)
            scene.view_layers[0].update()


def leave(made: Sequence[tuple[Any, Any]]) -> None:
    """Until no render goes on; a file that is saved meanwhile has none of it."""
    global _is_untidy
    _is_untidy = True
    for _, thing in made:
        thing[_MARK] = True
        thing.is_runtime_data = True


def expect() -> None:
    """After an undo: what was remembered during a bake is there again, and goes as soon as it may."""
    global _is_untidy
    _is_untidy = any(map(_made_in, _KINDS))
    if _is_untidy:
        clock.hasten(0.0)


def clear() -> None:
    """Takes away what was left; known by its mark, as an undo may have taken or renewed some of it."""
    global _is_untidy
    # at once: a film leaves some for each of its frames
    bpy.data.batch_remove([thing for kind in _KINDS for thing in _made_in(kind)])
    _is_untidy = False


def _made_in(kind: str) -> list[Any]:
    return [thing for thing in getattr(bpy.data, kind) if _MARK in thing and thing.library is None]
