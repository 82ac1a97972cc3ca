# SPDX-License-Identifier: GPL-3.0-or-later
"""The training set, and the training with its loss and newest image."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..errors import JGHandFailure
from ..export import ops_common
from ..export.panel import draw_job
from ..preferences import preferences
from ..renderer import job_watch, runtime
from ..renderer.job_state import Phase
from ..ui import Sidebar
from .training_folder import TrainingFolder, folder_of, is_in_the_way


class TrainPanel(Sidebar, bpy.types.Panel):
    """Learning an avatar."""

    bl_idname = "VIEW3D_PT_jghand_train"
    bl_label = "Train"
    bl_order = ui.TRAIN
    bl_options = ui.CLOSED

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        chosen = preferences()
        return chosen is not None and chosen.show_training

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand.training
        column = ui.settings(layout)
        column.prop(settings, "capture_folder")
        column.prop(settings, "avatar_file")
        column.prop(settings, "preset")
        column.prop(settings, "time_s")
        column.prop(settings, "all_pictures")
        if ui.kept(context, _look_in_the_way, settings.avatar_file):
            column.prop(settings, "overwrite")
        draw_job(layout, context, job_watch.TRAINING)
        seen = _training_folder(context)
        _draw_buttons(layout, seen)
        if seen is not None:
            _draw_course(layout, context, seen)


class TrainingSetPanel(Sidebar, bpy.types.Panel):
    """Pictures to learn from."""

    bl_idname = "VIEW3D_PT_jghand_training_set"
    bl_label = "Training Set"
    bl_parent_id = TrainPanel.bl_idname
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand.training
        column = ui.settings(layout)
        for name in ("identity", "cameras"):
            column.prop(settings, name)
        column.prop(settings, "use_motion")
        if not settings.use_motion:
            column.prop(settings, "poses")
        for name in ("size", "samples", "seed"):
            column.prop(settings, name)
        draw_job(layout, context, job_watch.CAPTURE)
        layout.operator("jghand.render_training_set", icon="RENDER_STILL")


def _training_folder(context: bpy.types.Context) -> TrainingFolder | None:
    """What is known of the training that the buttons act on: of the one that runs or is paused, else of the one beside
    the avatar's file."""
    job = runtime.jobs().get(job_watch.TRAINING)
    if job is not None and (not job.is_over or job.state.phase is Phase.PAUSED):
        return job_watch.look_at_training(job.spec.folder)
    try:
        return job_watch.look_at_training(
            folder_of(ops_common.place(context, context.scene.jghand.training.avatar_file))
        )
    except JGHandFailure:
        return None


def _look_in_the_way(context: bpy.types.Context, avatar_file: str) -> bool:
    try:
        out = ops_common.place(context, avatar_file)
    except JGHandFailure:
        return False
    return is_in_the_way(out, folder_of(out))


def _draw_buttons(layout: bpy.types.UILayout, seen: TrainingFolder | None) -> None:
    job = runtime.jobs().get(job_watch.TRAINING)
    row = layout.row(align=True)
    if job is not None and not job.is_over:
        row.operator("jghand.pause_training", icon="PAUSE")
        row.operator("jghand.cancel_job", text="Stop", icon="CANCEL").key = job_watch.TRAINING
    elif job is not None and job.state.phase is Phase.PAUSED:
        row.operator("jghand.resume_training", icon="PLAY")
        row.operator("jghand.cancel_job", text="Stop", icon="CANCEL").key = job_watch.TRAINING
    elif seen is not None and seen.can_go_on:
        row.operator("jghand.train", text="Resume", icon="PLAY").start = "resume"
        row.operator("jghand.train", text="Restart…", icon="FILE_REFRESH").start = "fresh"
    else:
        row.operator("jghand.train", icon="PLAY").start = "new"


# height of a picture in heights of a button: as wide as the sidebar is at first
_PICTURE_UNITS = 9.0


def _draw_course(layout: bpy.types.UILayout, context: bpy.types.Context, seen: TrainingFolder) -> None:
    said = seen.sentence(iface_)
    if said:
        ui.paragraph(layout, context, said)
    for icon in (job_watch.curve_icon(), job_watch.preview_icon()):
        if icon:
            layout.template_icon(icon_value=icon, scale=_PICTURE_UNITS)
    if seen.avatar is not None:
        layout.operator("jghand.load_avatar", text="Use Preview", icon="HIDE_OFF").filepath = str(seen.avatar)


CLASSES = (TrainPanel, TrainingSetPanel)
