# SPDX-License-Identifier: GPL-3.0-or-later
"""How the renderer is: in the tab while it is not ready, in the preferences always."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..core import panel_text
from . import runtime


def draw_status(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """One line; when something is wrong, the sentence, what to do, and buttons that do it."""
    report = runtime.last_report(runtime.VIEWPORT)
    frame_ms = report.get("total_ms") if report is not None else None
    status = panel_text.status_text(runtime.link().status, frame_ms, iface_)
    buttons = [button for button in status.buttons if ui.has_operator(button.operator)]
    if status.good:
        ui.explained(layout, panel_text.Line(status.text, tip=status.detail))
        return
    box = layout.box().column()
    ui.paragraph(box, context, status.text, icon="ERROR")
    if status.remedy:
        ui.paragraph(box, context, status.remedy, icon="BLANK1")
    if status.since or status.detail:
        ui.explained(box, panel_text.Line(status.since or iface_("Details"), tip=status.detail), icon="INFO")
    row = box.row(align=True)
    for button in buttons:
        row.operator(button.operator, text=button.label)
