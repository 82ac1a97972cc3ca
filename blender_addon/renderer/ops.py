# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderer by hand: start it again, see what it printed."""

from __future__ import annotations

import bpy

from ..errors import JGHandFailure
from ..ops import CANCELLED, DONE, ERROR, PLUMBING, REGISTERED, missing, sentence_of
from ..ui import PANELS, redraw
from . import runtime

LOG_NAME = "JGHand Renderer Log"


class RestartEngine(bpy.types.Operator):
    """Operator: ends the renderer, whatever it does, and starts another; also one that failed too often."""

    bl_idname = "jghand.restart_engine"
    bl_label = "Restart Renderer"
    bl_description = "End the renderer, whatever it is doing, and start it again. It also starts with the first image"
    bl_options = PLUMBING

    def execute(self, context: bpy.types.Context) -> set[str]:
        runtime.link().restart()
        redraw(*PANELS)
        if not bpy.app.background:
            return DONE
        try:  # without a window to show how it goes, when it is ready or failed
            runtime.link().wait_until_ready()
        except JGHandFailure as failure:
            self.report(ERROR, sentence_of(failure))
            return CANCELLED
        return DONE


class ShowLog(bpy.types.Operator):
    """Operator: what the renderer printed, as a text; in a text editor where there is one, else in a new window."""

    bl_idname = "jghand.show_log"
    bl_label = "Show Log"
    bl_description = "Open what the renderer printed in the Text Editor"
    bl_options = REGISTERED

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return bool(runtime.link().log) or missing(cls, "The renderer has printed nothing yet")

    def execute(self, context: bpy.types.Context) -> set[str]:
        text = bpy.data.texts.get(LOG_NAME) or bpy.data.texts.new(LOG_NAME)
        text.clear()
        text.write(runtime.link().log)
        if not bpy.app.background and context.window is not None:
            _show_text(context, text)
        return DONE


def _show_text(context: bpy.types.Context, text: bpy.types.Text) -> None:
    for window in context.window_manager.windows:
        for area in window.screen.areas:
            if area.type == "TEXT_EDITOR":
                area.spaces.active.text = text
                return
    bpy.ops.wm.window_new()
    area = context.window_manager.windows[-1].screen.areas[0]
    area.type = "TEXT_EDITOR"
    area.spaces.active.text = text


CLASSES = (RestartEngine, ShowLog)
