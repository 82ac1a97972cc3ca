# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake and export."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .. import ui
from ..errors import JGHandFailure
from ..render import scene_light
from ..renderer import runtime
from ..renderer.panel import draw_failure, draw_job
from . import bakes
from .ops_common import lacks_usd


class BakePanel(ui.HandSidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_bake"
    bl_label = "Bake"
    bl_order = ui.BAKE
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand.output
        column = _draw_what(layout, context, runtime.BAKE)
        column.prop(settings, "bake_folder")
        column.prop(settings, "bake_width_factor")
        _draw_usd(layout, context)
        layout.operator("jghand.bake", icon="RENDER_ANIMATION")
        hand = ui.active(context)
        if hand is None or not hand.jghand.bake:
            return
        column.prop(hand.jghand, "bake", text="Baked Into")
        _draw_bake(layout, context, hand)
        row = layout.row(align=True)
        row.operator("jghand.play_bake", icon="PLAY")
        row.operator("jghand.clear_bake", text="", icon="TRASH")


class ExportPanel(ui.HandSidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_export"
    bl_label = "Export"
    bl_order = ui.EXPORT
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand.output
        column = _draw_what(layout, context, runtime.EXPORT)
        column.prop(settings, "format")
        column.prop(settings, "folder")
        if settings.format == "usd":
            column.prop(settings, "program")
            column.prop(settings, "variant")
            column.prop(settings, "radiance")
            column.prop(settings, "width_factor")
            _draw_usd(layout, context)
        elif settings.format == "ply":
            column.prop(settings, "axes")
            column.prop(settings, "use_surfels")
            counted = column.column()
            counted.active = settings.use_surfels
            counted.prop(settings, "surfel_count")
            if scene_light.is_chosen(context.scene):
                ui.paragraph(layout, context, "Colors show the light of the scene in the current frame", icon="INFO")
        layout.operator("jghand.export", icon="EXPORT")


def _draw_what(layout: bpy.types.UILayout, context: bpy.types.Context, key: str) -> bpy.types.UILayout:
    """The job that writes hands, by its key, which hands, and which frames. Returns the column that they stand in."""
    settings = context.scene.jghand.output
    draw_job(layout, context, key)
    column = ui.settings(layout)
    column.row().prop(settings, "hands", expand=True)
    column.prop(settings, "use_scene_range")
    if not settings.use_scene_range:
        rows = column.column(align=True)
        rows.prop(settings, "frame_start")
        rows.prop(settings, "frame_end")
    return column


def _draw_usd(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Why the buttons below are gray, where they are for want of USD."""
    if ui.kept(context, lacks_usd):
        draw_failure(layout, context, JGHandFailure("no_usd"))


def _draw_bake(layout: bpy.types.UILayout, context: bpy.types.Context, hand: bpy.types.Object) -> None:
    """What the bake of a hand holds, and why it does not show what is seen now."""
    seen = ui.kept(context, _look_at_bake, hand.session_uid)
    if seen is None:
        return
    if seen.problem:
        ui.paragraph(layout, context, seen.problem + ".", icon="ERROR")
        return
    text = f"Baked: frames {seen.first} to {seen.last}"
    layout.label(text=text, icon="CHECKMARK" if not seen.reasons else "BLANK1", translate=False)
    if seen.reasons:
        what = "What plays here is not what the scene has" if seen.plays else "The bake is not what the scene has"
        said = f"{what}: {', '.join(seen.reasons)}."
        ui.paragraph(layout, context, said, icon="ERROR")
    space = context.space_data
    if seen.plays and isinstance(space, bpy.types.SpaceView3D) and space.shading.type == "SOLID":
        ui.paragraph(layout, context, "The colors of a bake show in Material Preview and Rendered", icon="INFO")


@dataclass(frozen=True)
class _SeenBake:
    """problem: why there is none, "" where there is · first, last: frames · reasons: why it is stale · plays: here."""

    problem: str = ""
    first: int = 0
    last: int = 0
    reasons: tuple[str, ...] = ()
    plays: bool = False


def _look_at_bake(context: bpy.types.Context, uid: int) -> _SeenBake | None:
    hand = next((thing for thing in context.scene.objects if thing.session_uid == uid), None)
    if hand is None or not hand.jghand.bake:
        return None
    try:
        folder = bakes.folder_of(hand)
        baked = bakes.read_bake(folder)
        reasons = bakes.stale_now(hand, context.evaluated_depsgraph_get(), baked)
    except JGHandFailure as failure:
        return _SeenBake(failure.advice.sentence)
    plays = bool(bakes.playing(context.scene, folder))
    return _SeenBake("", baked[0].first_frame, baked[0].last_frame, tuple(reasons), plays)


CLASSES = (BakePanel, ExportPanel)
