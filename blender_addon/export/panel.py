# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake and export."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui, versions
from ..errors import JGHandFailure
from ..hand import avatar_files
from ..hand.seen_hands import avatar_of
from ..renderer import job_watch, runtime
from ..renderer.job_state import Phase
from ..ui import Sidebar
from . import bake_folders, baked_points, bakes, ops_bake, ops_common, usd_hook
from .recording import SizeEstimate, Written, estimate


class BakePanel(Sidebar, bpy.types.Panel):
    """Bakes."""

    bl_idname = "VIEW3D_PT_jghand_bake"
    bl_label = "Bake"
    bl_order = ui.BAKE
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.any_hand(context)

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand.output
        column = _draw_what(layout, context)
        column.prop(settings, "bake_folder")
        if not versions.has_native_splats():
            column.prop(settings, "bake_width_factor")
        layout.operator("jghand.bake", icon="RENDER_ANIMATION")
        _draw_estimate(layout, context, settings.bake_folder, Written())
        hand = ui.active(context)
        if hand is None or not hand.jghand.bake:
            return
        column.prop(hand.jghand, "bake", text="Baked Into")
        stale = _draw_bake(layout, context, hand)
        row = layout.row(align=True)
        play = row.operator("jghand.play_bake", text="Play Anyway" if stale else "Play Bake", icon="PLAY")
        play.accept_stale = stale
        row.operator("jghand.check_bake", text="", icon="CHECKMARK")
        row.operator("jghand.clear_bake", text="", icon="TRASH")


class ExportPanel(Sidebar, bpy.types.Panel):
    """Exports."""

    bl_idname = "VIEW3D_PT_jghand_export"
    bl_label = "Export"
    bl_order = ui.EXPORT
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.any_hand(context)

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand.output
        column = _draw_what(layout, context)
        column.prop(settings, "format")
        column.prop(settings, "folder")
        if settings.format == "usd":
            column.prop(settings, "program")
            column.prop(settings, "variant")
            column.prop(settings, "sizes")
            column.prop(settings, "radiance")
            column.prop(settings, "width_factor")
        elif settings.format == "ply":
            column.prop(settings, "axes")
        column.prop(settings, "replace_others")
        layout.operator("jghand.export", icon="EXPORT")
        if settings.format != "motion":
            written = Written(ply=settings.format == "ply", sizes=settings.sizes == "per_frame")
            _draw_estimate(layout, context, settings.folder, written)
        layout.operator("jghand.export_scene_usd", icon="SCENE_DATA")
        for note in usd_hook.left_out():
            ui.paragraph(layout, context, note, icon="ERROR")


def _draw_what(layout: bpy.types.UILayout, context: bpy.types.Context) -> bpy.types.UILayout:
    """The job that writes hands, which hands, and which frames. Returns the column that they stand in."""
    settings = context.scene.jghand.output
    draw_job(layout, context, job_watch.OUTPUT)
    column = ui.settings(layout)
    column.row().prop(settings, "hands", expand=True)
    column.prop(settings, "use_scene_range")
    if not settings.use_scene_range:
        rows = column.column(align=True)
        rows.prop(settings, "frame_start")
        rows.prop(settings, "frame_end")
    return column


def _draw_bake(layout: bpy.types.UILayout, context: bpy.types.Context, hand: bpy.types.Object) -> bool:
    """What the bake of a hand holds, and why it does not show what is seen now. Returns whether it is stale."""
    seen = ui.kept(context, _look_at_bake, hand.session_uid)
    if seen is None:
        return False
    if seen.problem:
        ui.paragraph(layout, context, iface_(seen.problem) + ".", icon="ERROR")
        return False
    text = iface_("Baked: frames {first} to {last}").format(first=seen.first, last=seen.last)
    layout.label(text=text, icon="CHECKMARK" if not seen.reasons else "BLANK1", translate=False)
    if seen.reasons:
        what = "What plays here is not what the scene has" if seen.plays else "The bake is not what the scene has"
        said = f"{iface_(what)}: {', '.join(map(iface_, seen.reasons))}."
        ui.paragraph(layout, context, said, icon="ERROR")
    return bool(seen.reasons)


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
        folder = bake_folders.bake_folder(hand)
        baked = bakes.read_bake(folder)
        reasons = ops_bake.stale_now(context, hand, baked, folder)
    except JGHandFailure as failure:
        return _SeenBake(failure.advice.sentence)
    first, plays = baked[0].first_frame, bool(baked_points.playing(context.scene, folder))
    return _SeenBake("", first, first + baked[0].frames - 1, tuple(reasons), plays)


def draw_job(layout: bpy.types.UILayout, context: bpy.types.Context, key: str) -> None:
    """A job's progress with its button while it runs; afterwards why it failed, until the next one."""
    job = runtime.jobs().get(key)
    if job is None:
        return
    state = job.state
    if not job.is_over:
        row = layout.row(align=True)
        row.progress(factor=state.fraction or 0.0, text=state.sentence(iface_), translate=False)
        row.operator("jghand.cancel_job", text="", icon="CANCEL").key = key
        if job.silent_s > _SILENT_S:
            text = iface_("It has said nothing for {minutes} min").format(minutes=round(job.silent_s / 60))
            layout.label(text=text, icon="TIME", translate=False)
    elif state.phase is Phase.FAILED and state.failure is not None:
        ui.paragraph(layout, context, iface_(state.failure.advice.sentence) + ".", icon="ERROR")
        ui.paragraph(layout, context, iface_(state.failure.advice.remedy) + ".")
        if state.failure.detail:
            ui.paragraph(layout, context, state.failure.detail.splitlines()[0])
        layout.operator("jghand.show_job_log", icon="TEXT").key = key


# a picture of a capture takes a minute at most: longer silence is told
_SILENT_S = 120.0


def _draw_estimate(layout: bpy.types.UILayout, context: bpy.types.Context, folder: str, written: Written) -> None:
    """What the chosen hands and frames take, before the click."""
    size = ui.kept(context, _look_at_size, folder, written)
    if size is not None:
        layout.label(text=size.sentence(iface_), icon="NONE" if size.fits else "ERROR", translate=False)


def _look_at_size(context: bpy.types.Context, folder: str, written: Written) -> SizeEstimate | None:
    things = ops_common.hands_to_write(context)
    if not things:
        return None
    try:
        target = ops_common.place(context, folder)
    except JGHandFailure:
        target = None  # said after the click, with what to do
    hands = [avatar_files.gaussians_of(avatar_of(thing)) for thing in things]
    return estimate(target, hands, len(ops_common.frames_to_write(context)), written)


CLASSES = (BakePanel, ExportPanel)
