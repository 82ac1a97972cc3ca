# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures to learn a hand from, and learning it."""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import folders, ui
from ..errors import JGHandFailure
from ..export.ops_common import StartsJob, place
from ..export.recording import Recording
from ..hand import avatar_files
from ..hand.motion_files import FETCH, VIDEO_SUFFIXES, option_words
from ..hand.properties import HANDS as SIDES
from ..hand.seen_hands import HANDS
from ..ops import REGISTERED, FromFile, missing
from ..renderer import runtime
from ..renderer.jobs import JobSpec
from .training_folder import PICTURE, TOLD, TrainingFolder, capture_words, folder_of, picture_words, train_words

_FILMED_HANDS = (
    ("AUTO", "Detected", "The hand that the film shows", "NONE", 0),
    *((side, label, "Where two hands are seen, this one", "NONE", place + 1) for side, label, _, _, place in SIDES),
)
STARTS = (
    ("new", "New", "There is no training yet", "NONE", 0),
    ("resume", "Resume", "Continue where the training stands", "NONE", 1),
    ("fresh", "Restart", "Forget the training that the folder holds", "NONE", 2),
)


class RenderTrainingSet(StartsJob, bpy.types.Operator):
    bl_idname = "jghand.render_training_set"
    bl_label = "Render Training Set"
    bl_description = (
        "Render images of a rigged hand from all sides, path traced in a process of its own. "
        "What is there already is kept: started again it continues where it was stopped"
    )
    bl_options = REGISTERED

    key = runtime.CAPTURE
    watched = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene.jghand.training.use_motion and not ui.active(context):
            return missing(cls, "Select the hand whose poses are taken")
        return super().poll(context)

    def recorded_hands(self, context: bpy.types.Context) -> list[bpy.types.Object]:
        hand = ui.active(context)
        return [hand] if hand is not None and context.scene.jghand.training.use_motion else []

    def prepare(self, context: bpy.types.Context) -> None:
        place(context, context.scene.jghand.training.capture_folder)
        runtime.program(learns=True)

    def job(self, context: bpy.types.Context, recordings: list[Recording]) -> JobSpec:
        settings = context.scene.jghand.training
        self._folder = place(context, settings.capture_folder)
        motion, scratch = None, ()
        if recordings:
            scratch = (folders.job_folder(),)
            motion = scratch[0] / "capture.npz"
            recordings[0].save(motion)
        command = (*runtime.program(learns=True), *capture_words(self._folder, settings, motion))
        return JobSpec("Rendering the training set", command, scratch=scratch)

    def done(self, _context: bpy.types.Context) -> str:
        return f"The training set is in {self._folder}."


class Train(StartsJob, bpy.types.Operator):
    bl_idname = "jghand.train"
    bl_label = "Train Avatar"
    bl_description = (
        "Learn an avatar from the training set, in a process of its own that goes on while you work, "
        "also in another file. It can be paused; quitting Blender pauses it too"
    )
    bl_options = REGISTERED

    start: bpy.props.EnumProperty(name="Start", description="Where to begin", items=STARTS, default="new")

    key = runtime.TRAINING
    watched = False

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """The tooltip says what becomes of an earlier training."""
        if properties.start == "resume":
            return "Continue this training where it stands, in a process of its own"
        if properties.start == "fresh":
            return "Begin again: the training that the folder holds is lost"
        return cls.bl_description

    def overwritten(self, context: bpy.types.Context) -> str:
        """Hours of training, or an avatar's file that no training of this folder wrote."""
        out = place(context, context.scene.jghand.training.avatar_file)
        work = folder_of(out)
        seen = TrainingFolder.look(work)
        if self.start == "fresh" and seen.can_go_on:
            return f"The training in {work.name} is lost: {seen.sentence()}."
        if self.start == "new" and out.is_file():
            return f"{out} is replaced."
        return ""

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
        start = "" if self.start == "new" else self.start
        words = train_words(pictures, self._out, settings, start, overwrite=self.confirmed)
        return JobSpec("Training", (*runtime.program(learns=True), *words), folder_of(self._out))

    def done(self, _context: bpy.types.Context) -> str:
        return f"The avatar is {self._out}."


class HandFromFilm(FromFile, StartsJob, bpy.types.Operator):
    bl_idname = "jghand.hand_from_film"
    bl_label = "My Hand from a Film"
    bl_description = (
        "Make a hand of your own from a film of it, in a process of its own that goes on while you work, some "
        "minutes long. This needs the training tools; once, where Blender may go online, it downloads 35 MB. Nothing "
        "of the film leaves this machine"
    )
    bl_options = REGISTERED

    choices = ("hand", "hand_length")
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in VIDEO_SUFFIXES), options={"HIDDEN"}
    )
    hand: bpy.props.EnumProperty(name="Hand", description="Which hand is meant", items=_FILMED_HANDS)

    key = runtime.OWN
    watched = False

    def overwritten(self, _context: bpy.types.Context) -> str:
        """The hand of an earlier film of that name."""
        out = self._out()
        return f"{out} is replaced." if out.is_file() else ""

    def prepare(self, _context: bpy.types.Context) -> None:
        runtime.program(learns=True)

    def job(self, _context: bpy.types.Context, _recordings: list[Recording]) -> JobSpec:
        film, out = Path(bpy.path.abspath(self.filepath)), self._out()
        options = {
            "--hand": "" if self.hand == "AUTO" else self.hand,
            "--hand-length": f"{self.hand_length:g}" if self.hand_length else "",
            "--overwrite": self.confirmed,
            FETCH: runtime.is_online(),
        }
        program, scratch, work = runtime.program(learns=True), folders.job_folder(), out.with_suffix(".own")

        def take() -> None:
            (scratch / PICTURE).replace(out.with_suffix(avatar_files.PICTURE))
            (scratch / TOLD).replace(work / TOLD)

        return JobSpec(
            "Making your hand",
            (*program, "own", str(film), "--out", str(out), "--json", str(scratch / TOLD), *option_words(options)),
            work,
            more=((*program, *picture_words(out, scratch)),),
            on_done=take,
            scratch=(scratch,),
        )

    def done(self, _context: bpy.types.Context) -> str:
        return f"The avatar is {self._out()}."

    def _out(self) -> Path:
        """Among the hands that Add Hand offers."""
        name = avatar_files.name_of_film(Path(bpy.path.abspath(self.filepath)))
        return folders.user_folder(HANDS) / f"{name}{avatar_files.SUFFIX}"


CLASSES = (RenderTrainingSet, Train, HandFromFilm)
