# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine by hand: start, stop, start again, what it printed."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..errors import JGHandFailure
from ..ops import CANCELLED, DONE, ERROR, INFO, PLUMBING, REGISTERED, missing, sentence_of
from ..ui import PANELS, redraw
from . import runtime

LOG_NAME = "JGHand Engine Log"
_RUNS = ("starting", "ready", "slow")


class StartEngine(bpy.types.Operator):
    """Operator: starts the engine, also one that failed too often to start by itself."""

    bl_idname = "jghand.start_engine"
    bl_label = "Start Engine"
    bl_description = "Start the engine. It also starts by itself with the first picture"
    bl_options = PLUMBING

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return runtime.link().status.state not in _RUNS or missing(cls, "The engine runs already")

    def execute(self, context: bpy.types.Context) -> set[str]:
        runtime.link().start()
        return _ready(self, context)


class RestartEngine(bpy.types.Operator):
    """Operator: ends the engine, whatever it does, and starts another."""

    bl_idname = "jghand.restart_engine"
    bl_label = "Restart Engine"
    bl_description = "End the engine, whatever it is doing, and start it again. The scene is not touched"
    bl_options = PLUMBING

    def execute(self, context: bpy.types.Context) -> set[str]:
        runtime.link().restart()
        return _ready(self, context)


class StopEngine(bpy.types.Operator):
    """Operator: ends the engine; it stays off until it is started or something is rendered."""

    bl_idname = "jghand.stop_engine"
    bl_label = "Stop Engine"
    bl_description = "End the engine and free its memory. A render, or Start Engine, starts it again"
    bl_options = PLUMBING

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return runtime.link().status.state in _RUNS or missing(cls, "The engine is not running")

    def execute(self, context: bpy.types.Context) -> set[str]:
        runtime.link().stop()
        redraw(*PANELS)
        return DONE


class ShowLog(bpy.types.Operator):
    """Operator: what the engine printed, as a text; in a text editor where there is one, else in a new window."""

    bl_idname = "jghand.show_log"
    bl_label = "Show Log"
    bl_description = "Open what the engine printed in the Text Editor"
    bl_options = REGISTERED

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return runtime.link().has_log or missing(cls, "The engine has printed nothing yet")

    def execute(self, context: bpy.types.Context) -> set[str]:
        text = bpy.data.texts.get(LOG_NAME) or bpy.data.texts.new(LOG_NAME)
        text.clear()
        text.write(runtime.link().log)
        path = runtime.link().log_path
        if path is not None:
            self.report(INFO, rpt_("The whole log is in {path}").format(path=path))
        if not bpy.app.background and context.window is not None:
            _show_text(context, text)
        return DONE


def _ready(operator: bpy.types.Operator, context: bpy.types.Context) -> set[str]:
    """After a start: at once where there is a window to show how it goes, else when the engine is ready or failed."""
    redraw(*PANELS)
    if not bpy.app.background:
        return DONE
    try:
        runtime.link().wait_until_ready()
    except JGHandFailure as failure:
        operator.report(ERROR, sentence_of(failure))
        return CANCELLED
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


CLASSES = (StartEngine, RestartEngine, StopEngine, ShowLog)
