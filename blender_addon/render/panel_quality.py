# SPDX-License-Identifier: GPL-3.0-or-later
"""How good and how fast the viewport's pictures are, and what the last one did."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..core import panel_text
from ..core.panel_text import ReceiptText
from ..renderer import runtime
from ..ui import Sidebar
from .panel_presets import RENDER_PT_jghand_presets


class QualityPanel(Sidebar, bpy.types.Panel):
    """Quality and speed."""

    bl_idname = "VIEW3D_PT_jghand_quality"
    bl_label = "Quality and Speed"
    bl_order = ui.QUALITY

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.any_hand(context)

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """The presets."""
        RENDER_PT_jghand_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        row = column.row(align=True, heading="Frame Budget")
        row.prop(settings, "use_viewport_budget", text="")
        budget = row.row(align=True)
        budget.active = settings.use_viewport_budget
        budget.prop(settings, "viewport_budget_ms", text="ms")
        preset = column.row()
        preset.active = not settings.use_viewport_budget
        preset.prop(settings, "viewport_preset", text="Preset")
        column.prop(settings, "shadow_strength", text="Shadow", slider=True)
        column.prop(settings, "shadow_radius_mm", text="Radius")
        receipt = receipt_of(context, runtime.VIEWPORT)
        if receipt is None:
            ui.paragraph(layout, context, "No picture yet: its times will stand here.")
            return
        draw_receipt(layout, context, receipt)


class EffectsPanel(Sidebar, bpy.types.Panel):
    """Effects of the last picture."""

    bl_idname = "VIEW3D_PT_jghand_effects"
    bl_label = "Effects"
    bl_parent_id = QualityPanel.bl_idname
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        report = runtime.last_report(runtime.VIEWPORT)
        return report is not None and bool(report.get("effects"))

    def draw(self, context: bpy.types.Context) -> None:
        receipt = receipt_of(context, runtime.VIEWPORT)
        draw_effects(self.layout, receipt)


def receipt_of(context: bpy.types.Context, kind: str) -> ReceiptText | None:
    """The newest receipt of a kind in words; None before there is one."""
    report = runtime.last_report(kind)
    if report is None:
        return None
    settings = context.scene.jghand
    budgeted = kind == runtime.VIEWPORT and settings.use_viewport_budget
    return panel_text.receipt_text(report, settings.viewport_budget_ms if budgeted else None, iface_)


def draw_receipt(layout: bpy.types.UILayout, context: bpy.types.Context, receipt: ReceiptText) -> None:
    """Warnings, the whole, and its stages."""
    for line in receipt.warnings:
        ui.explained(layout, line, icon="ERROR")
    column = layout.column(align=True)
    ui.figure(column, receipt.total)
    for line in receipt.stages:
        ui.figure(column, line)


def draw_effects(layout: bpy.types.UILayout, receipt: ReceiptText) -> None:
    """What ran, then what did not; why is in the tooltips."""
    column = layout.column(align=True)
    for line in sorted(receipt.effects, key=lambda line: not line.good):
        row = column.row()
        row.active = line.good
        ui.explained(row, line, icon="CHECKMARK" if line.good else "BLANK1")


CLASSES = (QualityPanel, EffectsPanel)
