# SPDX-License-Identifier: GPL-3.0-or-later
"""How the renderer is: in the tab while it is not ready, in the preferences always; how jobs and the training tools
are."""

from __future__ import annotations

import bpy

from .. import ui
from ..core import panel_text
from ..errors import ADVICE, JGHandFailure
from ..preferences import JGHandPreferences
from . import runtime
from .jobs import Phase

# a picture of a capture takes a minute at most: longer silence is told
_SILENT_S = 120.0


def draw_status(layout: bpy.types.UILayout, context: bpy.types.Context, *, buttons: bool = True) -> None:
    """One line; when something is wrong, the sentence, what to do, and buttons that do it, unless they are there."""
    status = panel_text.status_text(runtime.link().status, runtime.reports.get(runtime.VIEWPORT))
    if status.good:
        ui.explained(layout, panel_text.Line(status.text, tip=status.detail))
        return
    box = layout.box().column()
    ui.paragraph(box, context, status.text, icon="ERROR")
    if status.which:
        ui.paragraph(box, context, status.which, icon="BLANK1")
    if status.remedy:
        ui.paragraph(box, context, status.remedy, icon="BLANK1")
    if status.since or status.detail:
        ui.explained(box, panel_text.Line(status.since or "Details", tip=status.detail), icon="INFO")
    row = box.row(align=True)
    for operator, label in status.buttons if buttons else ():
        properties = row.operator(operator, text=label)
        if operator == "preferences.addon_show":
            properties.module = JGHandPreferences.bl_idname


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, key: str) -> None:
    """A job's progress with its button while it runs; afterwards why it failed, until the next one."""
    job = runtime.jobs.get(key)
    if job is None:
        return
    state = job.state
    if not job.is_over:
        row = layout.row(align=True)
        row.progress(factor=state.fraction or 0.0, text=state.sentence(), translate=False)
        row.operator("jghand.cancel_job", text="", icon="CANCEL").key = key
        if job.silent_s > _SILENT_S:
            text = f"Silent for {panel_text.duration(job.silent_s)}"
            layout.label(text=text, icon="TIME", translate=False)
    elif state.phase is Phase.FAILED and state.failure is not None:
        draw_failure(layout, context, state.failure)
        layout.operator("jghand.show_log", icon="TEXT").key = key


def draw_failure(
    layout: bpy.types.UILayout, context: bpy.types.Context, failure: JGHandFailure, name: str = ""
) -> None:
    """What failed, of the thing of this name; what exactly, as far as it is one line; what to do."""
    sentence = failure.advice.sentence
    ui.paragraph(layout, context, f"{name}: {sentence}" if name else sentence, icon="ERROR")
    first, _, rest = failure.detail.partition("\n")
    first = panel_text.in_blenders_words(first)
    if first not in ("", name):
        ui.paragraph(layout, context, first, icon="BLANK1")
    ui.paragraph(layout, context, failure.advice.remedy, icon="BLANK1")
    if rest:
        ui.explained(layout, panel_text.Line("Details", tip=failure.detail), icon="INFO")


_STATES = {
    "missing": "Training, video tracking and your own hand need PyTorch, which is not installed",
    "broken": "The training tools are incomplete or of another version: install them again",
    "ready": "The training tools are installed",
}


def draw_tools(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What there is, and what can be done about it."""
    box = layout.box().column()
    draw_job(box, context, runtime.TOOLS)
    if runtime.jobs.runs(runtime.TOOLS):
        return
    now = runtime.tools_state()
    icon = "CHECKMARK" if now == "ready" else "ERROR" if now == "broken" else "INFO"
    ui.paragraph(box, context, _STATES[now], icon=icon)
    if now != "ready" and not runtime.is_online():
        ui.paragraph(box, context, ADVICE["offline"].remedy, icon="BLANK1")
    row = box.row(align=True)
    if now != "ready":
        row.operator("jghand.install_tools", icon="IMPORT")
    if now != "missing":
        row.operator("jghand.remove_tools", icon="TRASH")
