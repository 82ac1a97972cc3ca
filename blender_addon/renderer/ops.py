# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine by hand: check, start, stop, start again, what it printed."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_
from bpy.app.translations import pgettext_rpt as rpt_

from ..core import limits
from ..errors import JGHandFailure
from ..ops import CANCELLED, DONE, ERROR, INFO, PLUMBING, REGISTERED, WARNING, missing, sentence_of
from ..ui import PANELS, redraw
from . import runtime
from .engine_check import CheckResult, EngineCheck

LOG_NAME = "JGHand Engine Log"
_RUNS = ("starting", "ready", "slow")
# how wide a line of small print is drawn, letters
_LINE = 90


class CheckEngine(bpy.types.Operator):
    """Operator: looks which engine there is, without holding Blender up; Esc ends it."""

    bl_idname = "jghand.check_engine"
    bl_label = "Check Engine"
    bl_description = "Look which engine is found, what it is made of, and what would mend it"
    bl_options = REGISTERED

    _check: EngineCheck | None = None
    _timer: bpy.types.Timer | None = None

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Waits for the result."""
        self._check = runtime.start_check()
        self._check.wait(limits.CHECK_S + limits.WELCOME_S)
        return self._tell(context)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if bpy.app.background or context.window is None:
            return self.execute(context)
        self._check = runtime.start_check()
        self._timer = context.window_manager.event_timer_add(limits.CHECK_LOOK_S, window=context.window)
        context.window_manager.modal_handler_add(self)
        context.workspace.status_text_set(rpt_("Checking the engine  ·  Esc cancels"))
        redraw(*PANELS)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        if event.type == "ESC":
            self.cancel(context)
            runtime.forget_check()
            return CANCELLED
        if self._check.result is None and not self._check.over:
            return {"PASS_THROUGH"}
        self.cancel(context)
        return self._tell(context)

    def cancel(self, context: bpy.types.Context) -> None:
        """The end of looking; Blender calls it too, when a window closes."""
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            context.workspace.status_text_set(None)
        redraw(*PANELS)

    def _tell(self, context: bpy.types.Context) -> set[str]:
        result = self._check.result
        if result is None:
            self.report(ERROR, rpt_("The check did not come to an end"))
            return CANCELLED
        for finding in result.findings:
            print(f"jghand: {finding.label}: {finding.value}")
        text = rpt_(result.sentence)
        if result.good:
            self.report(INFO, text)
        else:
            mend = f": {result.mend}" if result.mend else ""
            self.report(WARNING, f"{text}. {rpt_(result.remedy)}{mend}")
        redraw(*PANELS)
        return DONE


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


def draw_check(layout: bpy.types.UILayout) -> None:
    """The button of the check and its newest result."""
    layout.operator(CheckEngine.bl_idname, icon="CHECKMARK")
    check = runtime.check()
    if check is None:
        return
    if check.result is None:
        layout.label(text="Checking…" if not check.over else "The check was canceled", icon="TIME")
        return
    draw_result(layout, check.result)


def draw_result(layout: bpy.types.UILayout, result: CheckResult) -> None:
    """What a check found, line by line, with the command that mends it."""
    box = layout.box().column(align=True)
    box.label(text=result.sentence, icon="CHECKMARK" if result.good else "ERROR")
    for finding in result.findings:
        row = box.split(factor=0.3)
        row.label(text=finding.label, icon="NONE" if finding.good else "ERROR")
        row.label(text=finding.value, translate=False)
    for line in result.detail.splitlines():
        for start in range(0, len(line), _LINE):
            box.label(text=line[start : start + _LINE], translate=False)
    if result.good:
        return
    box.separator()
    box.label(text=result.remedy)
    if result.mend:
        where = iface_(result.where)
        intro = iface_("In a terminal, in {where}:").format(where=where) if where else iface_("In a terminal:")
        box.label(text=intro, translate=False)
        row = box.row()
        row.label(text=result.mend, translate=False)
        row.operator(CopyCommand.bl_idname, text="", icon="COPYDOWN").text = result.mend


class CopyCommand(bpy.types.Operator):
    """Operator: puts a command into the clipboard."""

    bl_idname = "jghand.copy_command"
    bl_label = "Copy Command"
    bl_description = "Copy this command, to paste it into a terminal"
    bl_options = PLUMBING

    text: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})  # type: ignore[valid-type]

    def execute(self, context: bpy.types.Context) -> set[str]:
        context.window_manager.clipboard = self.text
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


CLASSES = (CheckEngine, StartEngine, RestartEngine, StopEngine, ShowLog, CopyCommand)
