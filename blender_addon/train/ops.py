# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures to learn a hand from, learning it, and avatars from disk."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from .. import folders
from ..errors import JGHandFailure
from ..export.ops_common import StartsJob, place, poll_job
from ..export.recording import Recording
from ..hand import armature
from ..ops import PLUMBING, REGISTERED, UNDOABLE, Reporting, missing
from ..renderer import engine_words, job_watch, runtime
from ..renderer.engine_words import CaptureChoices, TrainChoices
from ..renderer.job_state import Phase
from ..renderer.jobs import JobSpec
from .training_folder import TrainingReader, folder_of

STARTS = (
    ("new", "New", "There is no training yet", "NONE", 0),
    ("resume", "Resume", "Continue where the training stands", "NONE", 1),
    ("fresh", "Restart", "Forget the training that the folder holds", "NONE", 2),
)


class RenderTrainingSet(StartsJob, bpy.types.Operator):
    """Operator: pictures of a rigged hand, path traced."""

    bl_idname = "jghand.render_training_set"
    bl_label = "Render Training Set"
    bl_description = (
        "Render images of a rigged hand from all sides, path traced in a process of its own. "
        "What is there already is kept: started again it continues where it was stopped"
    )
    bl_options = REGISTERED

    key = job_watch.CAPTURE
    watched = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.jghand.training.use_motion and not _active_hand(context):
            return missing(cls, "Select the hand whose poses are taken")
        return poll_job(cls, job_watch.CAPTURE)

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        hand = _active_hand(context)
        return [hand] if hand is not None and context.scene.jghand.training.use_motion else []

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.training.capture_folder)
        runtime.program(learns=True)

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec:
        settings = context.scene.jghand.training
        self._folder = place(context, settings.capture_folder)
        motion, over = None, None
        if recordings:
            scratch = folders.job_folder()
            motion, over = scratch / "capture.npz", partial(folders.remove_job_folder, scratch)
            recordings[0].save(motion)
        choices = CaptureChoices(
            identity=settings.identity,
            cameras=settings.cameras,
            poses=settings.poses,
            size=tuple(settings.size),
            samples=settings.samples,
            seed=settings.seed,
            threads=0,
        )
        command = (*runtime.program(learns=True), *engine_words.capture(self._folder, choices, motion))
        title = "Rendering the training set"
        return JobSpec("capture", title, command, self._folder, resume=command, on_over=over)

    def done(self, _context: bpy.types.Context) -> str:
        return rpt_("The training set is in {folder}.").format(folder=self._folder)


class Train(StartsJob, bpy.types.Operator):
    """Operator: an avatar from pictures."""

    bl_idname = "jghand.train"
    bl_label = "Train Avatar"
    bl_description = (
        "Learn an avatar from the training set, in a process of its own that goes on while you work, "
        "also in another file. It can be paused; quitting Blender pauses it too"
    )
    bl_options = REGISTERED

    start: bpy.props.EnumProperty(name="Start", description="Where to begin", items=STARTS, default="new")  # type: ignore[valid-type]

    key = job_watch.TRAINING
    watched = False

    @classmethod
    def poll(cls, _context: bpy.types.Context) -> bool:
        return poll_job(cls, job_watch.TRAINING)

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """The tooltip says what becomes of an earlier training."""
        if properties.start == "resume":
            return "Continue this training where it stands, in a process of its own"
        if properties.start == "fresh":
            return "Begin again: the training that the folder holds is lost"
        return cls.bl_description

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks before hours of training are lost."""
        lost = self._lost(context) if self.start == "fresh" else ""
        if not lost:
            return super().invoke(context, event)
        return context.window_manager.invoke_confirm(
            self,
            event,
            title=rpt_("Restart Training?"),
            message=rpt_("The training in {folder} is lost: {what}.").format(folder=self._work.name, what=lost),
            confirm_text=rpt_("Restart"),
            icon="WARNING",
        )

    def recorded_hands(self, _context: bpy.types.Context) -> list[bpy.types.Object]:
        return []

    def prepare(self, context: bpy.types.Context) -> None:
        settings = context.scene.jghand.training
        pictures, out = place(context, settings.capture_folder), place(context, settings.avatar_file)
        if not pictures.is_dir():
            raise JGHandFailure("no_pictures", f"{pictures} is not there")
        if out.suffix != ".jghand":
            raise JGHandFailure("bad_input", f"{out}: wanted a file that ends with .jghand")
        runtime.program(learns=True)

    def job(self, context: bpy.types.Context, _recordings: list[Recording]) -> JobSpec:
        settings = context.scene.jghand.training
        pictures, self._out = place(context, settings.capture_folder), place(context, settings.avatar_file)
        choices = TrainChoices(
            preset=settings.preset,
            minutes=settings.time_s / 60,
            seed=settings.seed,
            all_pictures=settings.all_pictures,
            overwrite=settings.overwrite,
        )
        begin = "" if self.start == "new" else self.start
        program = runtime.program(learns=True)
        work = folder_of(self._out)
        job_watch.look_at_training(work)
        return JobSpec(
            "training",
            "Training",
            (*program, *engine_words.train(pictures, self._out, choices, begin)),
            work,
            resume=(*program, *engine_words.train(pictures, self._out, choices, "resume")),
        )

    def done(self, _context: bpy.types.Context) -> str:
        return rpt_("The avatar is {file}.").format(file=self._out)

    def _lost(self, context: bpy.types.Context) -> str:
        """What beginning anew takes away; "" where there is no training."""
        try:
            self._work = folder_of(place(context, context.scene.jghand.training.avatar_file))
        except JGHandFailure:
            return ""  # said after the click, with what to do
        seen = TrainingReader(self._work).look()
        return seen.lost_sentence(rpt_) if seen.can_go_on else ""


class PauseTraining(Reporting, bpy.types.Operator):
    """Operator: the training writes a checkpoint and its process ends."""

    bl_idname = "jghand.pause_training"
    bl_label = "Pause"
    bl_description = "Stop training for now: a checkpoint is written, and the processor is free until it goes on"
    bl_options = PLUMBING

    def run(self, _context: bpy.types.Context) -> None:
        job = runtime.jobs().get(job_watch.TRAINING)
        if job is None or job.is_over:
            raise JGHandFailure("bad_input", "no training runs")
        job.pause()
        job_watch.start()


class ResumeTraining(Reporting, bpy.types.Operator):
    """Operator: a paused training goes on."""

    bl_idname = "jghand.resume_training"
    bl_label = "Resume"
    bl_description = "Continue the training where it was paused"
    bl_options = PLUMBING

    def run(self, _context: bpy.types.Context) -> None:
        job = runtime.jobs().get(job_watch.TRAINING)
        if job is None or not job.is_over or job.state.phase is Phase.DONE:
            raise JGHandFailure("bad_input", "no training is paused")
        job.go_on()
        job_watch.start()


class LoadAvatar(Reporting, bpy.types.Operator):
    """Operator: an avatar file on the selected hands."""

    bl_idname = "jghand.load_avatar"
    bl_label = "Load Avatar"
    bl_description = "Choose the avatar file that is drawn on the selected hands"
    bl_options = UNDOABLE

    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    relative_path: bpy.props.BoolProperty(
        name="Relative Path",
        description="Keep the path as seen from the opened file, so that both can be moved together",
        options={"SKIP_SAVE"},
    )  # type: ignore[valid-type]
    filter_glob: bpy.props.StringProperty(default="*.jghand", options={"HIDDEN"})  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not _hands(context):
            return missing(cls, "Select a hand")
        if not _editable_hands(context):
            return missing(cls, "This hand is linked from another file: make it local, or an override, first")
        return True

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        if not self.properties.is_property_set("relative_path"):
            self.relative_path = context.preferences.filepaths.use_relative_paths
        if self.filepath:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def run(self, context: bpy.types.Context) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        if path.suffix != ".jghand" or not path.is_file():
            raise JGHandFailure("bad_avatar", f"{path}: wanted a file that ends with .jghand")
        kept = folders.relative(str(path)) if self.relative_path and context.blend_data.filepath else self.filepath
        hands = _editable_hands(context)
        for thing in hands:
            thing.jghand.avatar = kept
            thing.update_tag()
        if len(hands) < len(_hands(context)):
            self.warn(rpt_("Hands that are linked from another file keep their avatar."))


class DropAvatar(bpy.types.FileHandler):
    """Avatar files that are dropped into the viewport."""

    bl_idname = "JGHAND_FH_avatar"
    bl_label = "JGHand Avatar"
    bl_import_operator = LoadAvatar.bl_idname
    bl_file_extensions = ".jghand"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Onto a 3D view with a selected hand."""
        return context.area is not None and context.area.type == "VIEW_3D" and bool(_hands(context))


def _active_hand(context: bpy.types.Context) -> bpy.types.Object | None:
    thing = context.object
    return thing if thing is not None and armature.is_any_hand(thing) else None


def _hands(context: bpy.types.Context) -> list[bpy.types.Object]:
    chosen = {thing for thing in (context.object, *context.view_layer.objects.selected) if thing is not None}
    return [thing for thing in chosen if armature.is_any_hand(thing)]


def _editable_hands(context: bpy.types.Context) -> list[bpy.types.Object]:
    return [thing for thing in _hands(context) if thing.is_editable]


CLASSES = (RenderTrainingSet, Train, PauseTraining, ResumeTraining, LoadAvatar, DropAvatar)
