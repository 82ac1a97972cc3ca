# SPDX-License-Identifier: GPL-3.0-or-later
"""A combined picture without its hands does not stay on disk, nor one of a bake whose frame is not there.

What a scene of hands reports while another scene's compositor asks for it, Blender only prints: it writes the picture
without hands and goes on with the next frame. Handlers cannot keep it from writing, for they run after that. So what it
wrote is removed at once, and the output path is made one that cannot be written for as long as the render lasts: an
animation ends at the next frame, and Blender's own message has the reason in it.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from .. import runtime
from ..core.messages import JGHandFailure
from . import cache_player, combination

_failure: JGHandFailure | None = None
_began_s = 0.0
# session_uid of a scene -> its own output path
_paths: dict[int, str] = {}


def hands_failed(scene: bpy.types.Scene, failure: JGHandFailure) -> None:
    """The render engine could not draw the hands of this scene."""
    global _failure
    if combination.is_hands_scene(scene):
        _failure = failure


@persistent
def _frame_begins(scene: bpy.types.Scene, *_: object) -> None:
    global _failure, _began_s
    if not combination.is_hands_scene(scene):
        _failure, _began_s = None, time.time()
        runtime.note_render(None)


@persistent
def _frame_ends(scene: bpy.types.Scene, *_: object) -> None:
    failure = _failure if combination.hands_scene_of(scene) is not None else None
    failure = failure or cache_player.failure_in(scene)
    if failure is None:
        return
    for path in _written(scene):
        with contextlib.suppress(OSError):
            path.unlink()
    _paths.setdefault(scene.session_uid, scene.render.filepath)
    scene.render.filepath = os.path.join(os.devnull, f"JGHand: {failure.advice.sentence}")


@persistent
def _render_ends(*_: object) -> None:
    for scene in bpy.data.scenes:
        if scene.session_uid in _paths:
            scene.render.filepath = _paths.pop(scene.session_uid)


def _written(scene: bpy.types.Scene) -> Iterator[Path]:
    """The files that this frame was written to, as a picture of an animation or by itself."""
    alone = bpy.path.abspath(scene.render.filepath)
    names = (scene.render.frame_path(frame=scene.frame_current), alone, alone + scene.render.file_extension)
    for path in map(Path, names):
        # a whole second of room: the clocks of some disks are coarse
        if path.is_file() and path.stat().st_mtime > _began_s - 1.0:
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
    for name, handler in _HANDLERS:
        handlers = getattr(bpy.app.handlers, name)
        if handler in handlers:
            handlers.remove(handler)
    _paths.clear()
