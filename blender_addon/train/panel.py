# SPDX-License-Identifier: GPL-3.0-or-later
"""The training set, and the training with its loss and newest image."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy
import bpy.utils.previews
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..errors import JGHandFailure
from ..export import ops_common
from ..preferences import preferences
from ..renderer import runtime
from ..renderer.panel import draw_job
from ..ui import Sidebar
from .training_folder import TrainingFolder, TrainingReader, curve_picture, folder_of

# width and height of the picture of the loss
_CURVE_PX = (256, 160)

_reader: TrainingReader | None = None
_icons: Any = None  # Blender's collection of previews, once there are some
# what the icons show
_shown = TrainingFolder(Path())


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
        draw_job(layout, context, runtime.TRAINING)
        seen = ui.kept(context, _look_at_training, settings.avatar_file)
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
        draw_job(layout, context, runtime.CAPTURE)
        layout.operator("jghand.render_training_set", icon="RENDER_STILL")


def _look_at_training(context: bpy.types.Context, avatar_file: str) -> TrainingFolder | None:
    """What lies in the folder of the training that runs, or of the one beside the avatar's file; the log is read on."""
    global _reader
    job = runtime.jobs().get(runtime.TRAINING)
    if job is not None and runtime.jobs().runs(runtime.TRAINING):
        path = job.spec.folder
    else:
        try:
            path = folder_of(ops_common.place(context, avatar_file))
        except JGHandFailure:
            return None
    if _reader is None or _reader.path != path:
        _reader = TrainingReader(path)
    seen = _reader.look()
    if not bpy.app.background:  # where there are icons
        _show(seen)
    return seen


def _show(seen: TrainingFolder) -> None:
    """Makes icons of the loss and of the newest image, where they are others than before."""
    global _icons, _shown
    if _icons is None:  # without icons it is false
        _icons = bpy.utils.previews.new()
    before, _shown = _shown, seen
    if before.loss != seen.loss or before.path != seen.path:
        _icons.pop("loss", None)
        if seen.loss.steps:
            ui.store_picture(_icons, "loss", curve_picture(seen.loss, *_CURVE_PX))
    if before.picture != seen.picture:
        _icons.pop("picture", None)
        if seen.picture is not None:
            _icons.load("picture", str(seen.picture), "IMAGE")


def _draw_buttons(layout: bpy.types.UILayout, seen: TrainingFolder | None) -> None:
    row = layout.row(align=True)
    if runtime.jobs().runs(runtime.TRAINING):
        row.operator("jghand.cancel_job", text="Pause", icon="PAUSE").key = runtime.TRAINING
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
    for name in ("loss", "picture"):
        if _icons is not None and name in _icons:
            layout.template_icon(icon_value=_icons[name].icon_id, scale=_PICTURE_UNITS)
    if seen.avatar is not None:
        layout.operator("jghand.load_avatar", text="Use Preview", icon="HIDE_OFF").filepath = str(seen.avatar)


CLASSES = (TrainPanel, TrainingSetPanel)


def unregister() -> None:
    """Frees the icons."""
    global _icons, _reader, _shown
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
    _icons, _reader, _shown = None, None, TrainingFolder(Path())
