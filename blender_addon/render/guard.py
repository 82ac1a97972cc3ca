# SPDX-License-Identifier: GPL-3.0-or-later
"""A combined picture without its hands is not written, nor one of a bake whose frame is not there.

What a scene of hands reports while another scene's compositor asks for it, Blender only prints: it would write the
picture without hands and go on with the next frame. So, as soon as the hands have failed, a folder stands where the
picture would be written (`render/obstacle.py`): Blender fails to write it, which ends the render with an error, a still
and the last frame of an animation as well. What was there before stays.

Where no folder can be put, what Blender wrote is removed and the output path is made one that cannot be written for as
long as the render lasts. A movie is written frame by frame into one file: it gets a name that says what it is. The
reason is printed, and in a window a menu says it; a render without files has no other sign of it.
"""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_

from .. import ui
from ..errors import JGHandFailure
from ..renderer import runtime
from . import composite, obstacle
from .obstacle import Obstacle

# added to the name of a movie with frames whose hands are missing
MOVIE_MARK = "_hands_missing"


@dataclass(frozen=True)
class _Frame:
    """The frame that is rendered now. uid: session_uid of its scene · number · began_s: on the system's clock"""

    uid: int
    number: int
    began_s: float


_frame: _Frame | None = None
_failure: JGHandFailure | None = None
_obstacles: list[Obstacle] = []
# session_uid of a scene -> its own output path
_paths: dict[int, str] = {}
# session_uid of a scene -> the movie that it writes, in which hands are missing
_movies: dict[int, Path] = {}
# a render's handler may run on a thread of its own: it notes the sentence, the timer on the main thread shows it
_pending = ""


def hands_failed(scene: bpy.types.Scene, failure: JGHandFailure) -> None:
    """The render engine could not draw the hands of this scene."""
    if composite.is_hands_scene(scene):
        _fail(failure)


def show() -> None:
    """Shows why the picture failed, if one did; for the timer, once no render runs."""
    global _pending
    if _pending:
        text, _pending = _pending, ""
        ui.show_message(text, icon="ERROR")


@persistent
def _frame_begins(scene: bpy.types.Scene, *_: object) -> None:
    global _frame, _failure
    if not composite.is_hands_scene(scene):
        _frame, _failure = _Frame(scene.session_uid, scene.frame_current, time.time()), None
        runtime.note_render(None)


@persistent
def _frame_ends(scene: bpy.types.Scene, *_: object) -> None:
    global _frame
    failure = _failure if _frame is not None else None
    before, _frame = _frame, None
    if failure is None:
        return
    barred = bool(_obstacles) and all(each.stands for each in _obstacles)
    _take_obstacles_away()
    if barred or scene.render.is_movie_format:
        return
    for path in _written(scene, before.began_s if before is not None else time.time()):
        with contextlib.suppress(OSError):
            path.unlink()
    _paths.setdefault(scene.session_uid, scene.render.filepath)
    scene.render.filepath = os.path.join(os.devnull, f"JGHand: {failure.advice.sentence}")


@persistent
def _render_ends(*_: object) -> None:
    global _frame
    _frame = None
    _take_obstacles_away()
    for scene in bpy.data.scenes:
        if scene.session_uid in _paths:
            scene.render.filepath = _paths.pop(scene.session_uid)
    for movie in _movies.values():
        with contextlib.suppress(OSError):  # it may be open elsewhere
            movie.replace(movie.with_stem(movie.stem + MOVIE_MARK))
    _movies.clear()


def _fail(failure: JGHandFailure) -> None:
    """The picture of the present frame is not to be written."""
    global _failure, _pending
    if _frame is None or _failure is not None:
        return
    _failure = failure
    scene = next((each for each in bpy.data.scenes if each.session_uid == _frame.uid), None)
    if scene is None:
        return
    reason = f"{rpt_(failure.advice.sentence)}. {rpt_(failure.advice.remedy)}"
    text = iface_("Frame {frame} has no hands and is not written: {reason}")
    if scene.render.is_movie_format:
        text = iface_("Frame {frame} of the movie has no hands: {reason}")
        _movies[scene.session_uid] = Path(bpy.path.abspath(scene.render.frame_path(frame=_frame.number)))
    else:
        _obstacles.extend(obstacle.put(_targets(scene, _frame.number)))
    text = text.format(frame=_frame.number, reason=reason)
    if bpy.app.background:
        print(f"JGHand: {text}", file=sys.stderr, flush=True)
    elif failure.kind != "canceled":
        _pending = text


def _take_obstacles_away() -> None:
    obstacle.take_away(_obstacles)
    _obstacles.clear()


def _targets(scene: bpy.types.Scene, frame: int) -> list[Path]:
    """Where Blender may write a frame: as a picture of an animation, or by itself; it does not say which it does."""
    alone, suffix = Path(bpy.path.abspath(scene.render.filepath)), scene.render.file_extension
    paths = [Path(bpy.path.abspath(scene.render.frame_path(frame=frame)))]
    if alone.name and not scene.render.filepath.endswith(("/", "\\")):
        # an extension that is another format's is replaced, anything else stays before it
        paths += [alone.with_name(alone.name + suffix), alone.with_suffix(suffix)]
        paths += [] if scene.render.use_file_extension else [alone]
    return paths


def _written(scene: bpy.types.Scene, began_s: float) -> Iterator[Path]:
    """The files that this frame was written to."""
    for path in _targets(scene, scene.frame_current):
        # a whole second of room: the clocks of some disks are coarse
        if path.is_file() and path.stat().st_mtime > began_s - 1.0:
            yield path


_HANDLERS = (
    ("render_pre", _frame_begins),
    ("render_post", _frame_ends),
    ("render_complete", _render_ends),
    ("render_cancel", _render_ends),
)


def register() -> None:
    """Begins to look."""
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler not in handlers:
            handlers.append(handler)


def unregister() -> None:
    """Ends it."""
    global _frame, _pending
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    _take_obstacles_away()
    _frame, _pending = None, ""
    _paths.clear()
    _movies.clear()
