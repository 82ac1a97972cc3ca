# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings of pictures in the Properties editor, as Cycles has its own, and what the last pictures took.

Quality applies to every scene with hands, for the viewport and the compositor draw them with other engines
too; film, motion blur and passes are Blender's own there.
"""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..core import panel_text
from ..core.panel_text import ReceiptText
from ..ops import PLUMBING
from ..renderer import runtime
from ..viewport import views
from . import ENGINE

PRESET_VALUES = (
    *("render_preset", "motion_samples"),
    *("viewport_preset", "sharpen_when_still", "use_viewport_budget", "viewport_budget_ms"),
)
FOLDER = "jghand/pictures"


class RENDER_PT_jghand_presets(PresetPanel, bpy.types.Panel):  # noqa: N801 - Blender finds it by this name
    """The list of presets, with a field to add one."""

    bl_label = "JGHand Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "jghand.add_picture_preset"


class AddPicturePreset(AddPresetBase, bpy.types.Operator):
    bl_idname = "jghand.add_picture_preset"
    bl_label = "Add JGHand Preset"
    bl_description = "Keep quality and speed of hands in the viewport and in renders under a name"
    bl_options = PLUMBING

    preset_menu = RENDER_PT_jghand_presets.__name__
    preset_subdir = FOLDER
    preset_defines = ["settings = bpy.context.scene.jghand"]  # noqa: RUF012 - Blender's own name and type
    preset_values = [f"settings.{name}" for name in PRESET_VALUES]  # noqa: RUF012 - Blender's own name and type


class _Page:
    """A panel of Render Properties."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"


class _OwnPage(_Page):
    """One that shows while the scene is rendered by JGHand."""

    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - Blender's own name and type

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine in cls.COMPAT_ENGINES


class QualityPage(_Page, bpy.types.Panel):
    """How hands are drawn, in every scene with hands."""

    bl_idname = "RENDER_PT_jghand_quality"
    bl_label = "Hands"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine == ENGINE or ui.any_hand(context)

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        RENDER_PT_jghand_presets.draw_panel_header(self.layout)

    def draw(self, _context: bpy.types.Context) -> None:
        pass


class ViewportPage(_Page, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_viewport"
    bl_label = "Viewport"
    bl_parent_id = QualityPage.bl_idname

    def draw(self, context: bpy.types.Context) -> None:
        column, settings = ui.settings(self.layout), context.scene.jghand
        column.prop(settings, "show_in_viewport")
        column = column.column()
        column.active = settings.show_in_viewport
        row = column.row(align=True, heading="Frame Budget")
        row.prop(settings, "use_viewport_budget", text="")
        budget = row.row(align=True)
        budget.active = settings.use_viewport_budget
        budget.prop(settings, "viewport_budget_ms", text="ms")
        preset = column.row()
        preset.active = not settings.use_viewport_budget
        preset.prop(settings, "viewport_preset", text="Quality")
        column.prop(settings, "sharpen_when_still")


class RenderPage(_Page, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_render"
    bl_label = "Render"
    bl_parent_id = QualityPage.bl_idname

    def draw(self, context: bpy.types.Context) -> None:
        column, settings = ui.settings(self.layout), context.scene.jghand
        column.prop(settings, "render_preset", text="Quality")
        column.prop(settings, "motion_samples")


class StatisticsPage(_Page, bpy.types.Panel):
    """What the last pictures took, and why."""

    bl_idname = "RENDER_PT_jghand_statistics"
    bl_label = "Statistics"
    bl_parent_id = QualityPage.bl_idname
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        dropped = views.late_frames()
        if dropped:
            text = iface_("Dropped frames: {count}").format(count=dropped)
            tip = iface_("Frames of the last playback that were drawn before their image came")
            ui.explained(self.layout, panel_text.Line(text, tip=tip), icon="INFO")
        for kind, title in ((runtime.VIEWPORT, "Viewport"), (runtime.RENDER, "Render")):
            receipt = receipt_of(context, kind)
            if receipt is not None:
                self.layout.label(text=title)
                _draw_receipt(self.layout, receipt)


class FilmPage(_OwnPage, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_film"
    bl_label = "Film"

    def draw(self, context: bpy.types.Context) -> None:
        ui.settings(self.layout).prop(context.scene.render, "film_transparent", text="Transparent")


class MotionBlurPage(_OwnPage, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_motion_blur"
    bl_label = "Motion Blur"
    bl_options = ui.CLOSED

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        column, render = ui.settings(self.layout), context.scene.render
        column.active = render.use_motion_blur
        column.prop(render, "motion_blur_position", text="Position")
        column.prop(render, "motion_blur_shutter")
        column.template_curve_mapping(render, "motion_blur_shutter_curve")


class PassesPage(_OwnPage, bpy.types.Panel):
    bl_idname = "VIEWLAYER_PT_jghand_passes"
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        column = ui.settings(self.layout)
        column.prop(context.view_layer, "use_pass_z", text="Depth")
        column.prop(context.scene.jghand, "use_pass_ids")


def receipt_of(context: bpy.types.Context, kind: str) -> ReceiptText | None:
    """The newest receipt of a kind in words; None before there is one."""
    report = runtime.last_report(kind)
    if report is None:
        return None
    settings = context.scene.jghand
    budgeted = kind == runtime.VIEWPORT and settings.use_viewport_budget
    return panel_text.receipt_text(report, settings.viewport_budget_ms if budgeted else None, iface_)


def _draw_receipt(layout: bpy.types.UILayout, receipt: ReceiptText) -> None:
    """Warnings, the whole and its stages, and the effects: those that ran first; why is in the tooltips."""
    for line in receipt.warnings:
        ui.explained(layout, line, icon="ERROR")
    column = layout.column(align=True)
    ui.figure(column, receipt.total)
    for line in receipt.stages:
        ui.figure(column, line)
    for line in sorted(receipt.effects, key=lambda line: not line.good):
        row = column.row()
        row.active = line.good
        ui.explained(row, line, icon="CHECKMARK" if line.good else "BLANK1")


CLASSES = (
    *(RENDER_PT_jghand_presets, AddPicturePreset),
    *(QualityPage, ViewportPage, RenderPage, StatisticsPage, FilmPage, MotionBlurPage, PassesPage),
)
