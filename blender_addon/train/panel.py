# SPDX-License-Identifier: GPL-3.0-or-later
"""The training set, and the training with its newest image."""

from __future__ import annotations

import json
from pathlib import Path

import bpy
import bpy.utils.previews

from .. import ui
from ..errors import ADVICE, JGHandFailure
from ..export import ops_common
from ..hand import avatar_files, properties
from ..hand.panel import HandPanel
from ..preferences import preferences
from ..renderer import runtime
from ..renderer.jobs import Phase
from ..renderer.panel import draw_failure, draw_job, draw_tools
from ..ui import Sidebar
from .training_folder import TOLD, TrainingFolder, folder_of


class TrainPanel(Sidebar, bpy.types.Panel):
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
    """What lies in the folder of the training that runs, or of the one beside the avatar's file."""
    job = runtime.jobs.get(runtime.TRAINING)
    if job is not None and runtime.jobs.runs(runtime.TRAINING):
        path = job.spec.folder
    else:
        try:
            path = folder_of(ops_common.place(context, avatar_file))
        except JGHandFailure:
            return None
    return TrainingFolder.look(path)


def _draw_buttons(layout: bpy.types.UILayout, seen: TrainingFolder | None) -> None:
    row = layout.row(align=True)
    if runtime.jobs.runs(runtime.TRAINING):
        row.operator("jghand.cancel_job", text="Pause", icon="PAUSE").key = runtime.TRAINING
    elif seen is not None and seen.can_go_on:
        row.operator("jghand.train", text="Resume", icon="PLAY").start = "resume"
        row.operator("jghand.train", text="Restart…", icon="FILE_REFRESH").start = "fresh"
    else:
        row.operator("jghand.train", icon="PLAY").start = "new"


# height of a picture in heights of a button: as wide as the sidebar is at first
_PICTURE_UNITS = 9.0


def _draw_course(layout: bpy.types.UILayout, context: bpy.types.Context, seen: TrainingFolder) -> None:
    job = runtime.jobs.get(runtime.TRAINING)
    if job is not None and not job.is_over:
        ui.paragraph(layout, context, job.state.text)  # whole: the bar of its progress has no room for loss and dB
    elif seen.can_go_on:
        layout.label(text=seen.sentence())
    if seen.picture is not None:
        layout.template_icon(icon_value=properties.icon_of(seen.picture), scale=_PICTURE_UNITS)
    if seen.avatar is not None:
        layout.operator("jghand.load_avatar", text="Use Preview", icon="HIDE_OFF").filepath = str(seen.avatar)


# how to film, as docs/OWN_HAND.md has it
_FILMING = (
    "Lean the telephone on something: it must not move. The hand fills half of the frame; bare forearm, no ring",
    "Light from the front or the side; behind the hand a wall of another color",
    "Hold exposure and focus by a long press; no beauty or night mode. Film 12 to 20 seconds, slowly",
    "Flat hand, fingers apart, palm to the camera, 2 s. A fist, and open",
    "Turn it over the thumb's side in 3 s; flat back, 2 s. A fist, and open. Tips to the camera and away. Turn back",
)


class FilmPanel(Sidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_film"
    bl_label = "My Hand from a Film"
    bl_parent_id = HandPanel.bl_idname
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout, job = self.layout, runtime.jobs.get(runtime.OWN)
        draw_job(layout, context, runtime.OWN)
        if job is not None and not job.is_over:
            return
        if job is not None and job.state.phase is Phase.DONE:
            _draw_own(layout, context, job.spec.folder)
        _draw_film_button(layout, context)
        for number, line in enumerate(_FILMING, 1):
            ui.paragraph(layout, context, f"{number}. {line}.")


def _draw_film_button(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """Or what it lacks."""
    try:
        runtime.program(learns=True)
    except JGHandFailure as failure:
        if failure.kind == "no_tools":
            draw_tools(layout, context)
        else:
            draw_failure(layout, context, failure)
        return
    layout.operator("jghand.hand_from_film", text="Choose a Film…", icon="FILE_MOVIE")
    if not runtime.is_online():
        text = "The networks that find a hand are downloaded with the first film. If they are not on this computer yet"
        ui.paragraph(layout, context, f"{text}: {ADVICE['offline'].remedy}", icon="INFO")


def _look_at_findings(_context: bpy.types.Context, file: str) -> list[str]:
    """Sentences on what is wrong with a film, and with the hand that was made of it all the same."""
    try:
        told = json.loads(Path(file).read_text(encoding="utf-8"))
        return [str(finding["sentence"]) for finding in told["findings"]]
    except (OSError, ValueError, TypeError, KeyError):
        return []


def _draw_own(layout: bpy.types.UILayout, context: bpy.types.Context, work: Path) -> None:
    """The proof of a hand that was made, and what can be done with it. work: its folder of work"""
    proof, avatar = work / "sheet.png", work.with_suffix(avatar_files.SUFFIX)
    for sentence in ui.kept(context, _look_at_findings, str(work / TOLD)) or ():
        ui.paragraph(layout, context, sentence, icon="INFO")
    if proof.is_file():
        layout.template_icon(icon_value=properties.icon_of(proof), scale=_PICTURE_UNITS)
        layout.operator("wm.path_open", text="Film and Hand Side by Side", icon="IMAGE_DATA").filepath = str(proof)
    if any(item[0] == avatar.stem for item in properties.hand_items()):
        row = layout.row()
        row.operator_menu_enum("jghand.add_hand", "handedness", text="Add My Hand", icon="ADD").avatar = avatar.stem
        row.operator("jghand.load_avatar", text="On Selected Hands").filepath = str(avatar)


CLASSES = (TrainPanel, TrainingSetPanel, FilmPanel)
