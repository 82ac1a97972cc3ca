# SPDX-License-Identifier: GPL-3.0-or-later
"""Work that no operator does: a context with a window for it, and one step that can be undone."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import bpy


@contextmanager
def in_a_window(scene_uid: int | None = None) -> Iterator[bpy.types.Context]:
    """A context with a window, which timers have none of; one that shows the scene with this session_uid, where there
    is one. Blender without windows has its own context."""
    windows = list(bpy.context.window_manager.windows)
    if bpy.context.window is not None:
        windows.insert(0, bpy.context.window)
    fitting = [window for window in windows if scene_uid is None or window.scene.session_uid == scene_uid]
    with bpy.context.temp_override(window=fitting[0]) if fitting else nullcontext():
        yield bpy.context


@contextmanager
def one_step(message: str) -> Iterator[bpy.types.Context]:
    """The context to change things in; what was changed is one step of undo."""
    with in_a_window() as context:
        yield context
        if not bpy.app.background and bpy.ops.ed.undo_push.poll():
            bpy.ops.ed.undo_push(message=message)
