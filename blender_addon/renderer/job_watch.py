# SPDX-License-Identifier: GPL-3.0-or-later
"""Looks after the jobs beside Blender's own work, keeps what a training shows, and has the panels drawn anew.

Nothing of this is in the opened file: a training goes on while another one is opened. Without a window the timer never
fires; there, who starts a job waits for it.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews
import numpy as np

from .. import clock
from ..core import limits
from ..train.training_folder import TrainingFolder, TrainingReader, curve_picture
from ..ui import PANELS, redraw, store_picture
from . import runtime

# keys of jobs in the table
OUTPUT, CAPTURE, TRAINING, IMPORT = "output", "capture", "training", "import"

_reader: TrainingReader | None = None
_seen: TrainingFolder | None = None
_icons: bpy.utils.previews.ImagePreviewCollection | None = None
_looked_turns = 0


def timers_fire() -> bool:
    """Whether somebody looks after a job that nobody waits for: timers never fire without a window."""
    return not bpy.app.background


def start() -> None:
    """Begins to look, unless it does already."""
    if timers_fire() and not bpy.app.timers.is_registered(_tick):
        bpy.app.timers.register(_tick, first_interval=limits.JOB_LOOK_S, persistent=True)


def look_at_training(path: Path) -> TrainingFolder:
    """What lies in the folder of a training, as it was seen last; a folder that is asked for the first time is read."""
    global _reader, _seen
    if _reader is None or _reader.path != path or _seen is None:
        _reader = TrainingReader(path)
        _look()
    assert _seen is not None  # _look has set it
    return _seen


def look_again() -> None:
    """Reads the training's folder anew."""
    if _reader is not None:
        _look()


def curve_icon() -> int:
    """Blender's number of the picture of the loss; 0 where there is none."""
    return _icons["loss"].icon_id if _icons is not None and "loss" in _icons else 0


def preview_icon() -> int:
    """Blender's number of the training's newest picture; 0 where there is none."""
    return _icons["picture"].icon_id if _icons is not None and "picture" in _icons else 0


def register() -> None:
    """Nothing is looked at before there is a job."""


def unregister() -> None:
    """Ends the timer and frees the pictures."""
    global _icons, _reader, _seen
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
    _icons = _reader = _seen = None


@clock.guarded(limits.JOB_LOOK_S)
def _tick() -> float | None:
    """The timer; None when nothing runs any more."""
    global _looked_turns
    table = runtime.jobs()
    changed = table.tick()
    _looked_turns += 1
    training = table.get(TRAINING)
    if training is not None and (changed or _looked_turns * limits.JOB_LOOK_S > limits.TRAINING_LOOK_S):
        _looked_turns = 0
        look_again()
        changed = True
    if changed:
        redraw(*PANELS)
    return limits.JOB_LOOK_S if table.running else None


def _look() -> None:
    global _seen
    assert _reader is not None  # callers have looked
    before, _seen = _seen, _reader.look()
    if bpy.app.background:
        return  # there are no icons
    if before is None or before.path != _seen.path or before.loss != _seen.loss:
        _store("loss", curve_picture(_seen.loss, *limits.CURVE_PX) if _seen.loss.steps else None)
    if before is None or before.picture != _seen.picture:
        _load("picture", _seen.picture)


def _collection() -> bpy.utils.previews.ImagePreviewCollection:
    global _icons
    if _icons is None:
        _icons = bpy.utils.previews.new()
    return _icons


def _store(key: str, picture: np.ndarray | None) -> None:
    icons = _collection()
    if picture is None:
        if key in icons:
            del icons[key]
        return
    store_picture(icons, key, picture)


def _load(key: str, path: Path | None) -> None:
    icons = _collection()
    if key in icons:
        del icons[key]
    if path is not None:
        icons.load(key, str(path), "IMAGE")
