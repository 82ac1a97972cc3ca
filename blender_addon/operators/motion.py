# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion files as keys of a hand, chosen or dropped into the viewport. The engine reads those of other programs."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TypeVar

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy_extras.io_utils import ImportHelper

from .. import runtime
from ..bridge import armature, controls, folders, motion
from ..bridge.classes import register_classes, register_menu, unregister_classes, unregister_menu
from ..core import limits
from ..core.aside import aside
from ..core.jobs import Job, JobSpec
from ..core.messages import JGHandFailure
from ..core.motion_conversion import FOREIGN_SUFFIXES, OWN_SUFFIXES, ConversionChoices, read_converted, words
from ..core.motion_files import MotionFile, read_motion
from . import common
from .common import CANCELLED, UNDOABLE_IMPORT, InTurns, missing

_Result = TypeVar("_Result")
# Blender's own importers take glTF and USD that are dropped
DROPPED_SUFFIXES = (*OWN_SUFFIXES, ".npy", ".bvh")
_TARGETS = (
    ("AUTO", "Active or New", "The active hand, where it is of the motion's side; else a new one", "NONE", 0),
    ("ACTIVE", "Active Hand", "The active hand only", "NONE", 1),
    ("NEW", "New Hand", "A new hand with the bone lengths of the motion", "NONE", 2),
)

_HANDS = (
    ("AUTO", "As the File Says", "Where it does not, or shows both, the side of the active hand", "NONE", 0),
    ("right", "Right", "The right hand of the file", "NONE", 1),
    ("left", "Left", "The left hand of the file", "NONE", 2),
)
_UNITS = (
    ("AUTO", "Automatic", "As the file says, else recognised by the size of the hand", "NONE", 0),
    ("m", "Metres", "The file's unit", "NONE", 1),
    ("cm", "Centimetres", "The file's unit", "NONE", 2),
    ("mm", "Millimetres", "The file's unit", "NONE", 3),
)


# options that only files of other programs need
_OF_OTHERS = ("hand", "unit", "hand_length", "part", "in_place")


class ImportMotion(InTurns, ImportHelper, bpy.types.Operator):
    """Operator: a motion file onto a hand."""

    bl_idname = "jghand.import_motion"
    bl_label = "Import Motion"
    bl_description = (
        "Key a motion on the active hand or on a new one: jghand's own files, and through the engine BVH, glTF, USD, "
        "and joints of OpenPose, MediaPipe, FreeMoCap and headsets. The action before it stays in the file. Esc cancels"
    )
    bl_options = UNDOABLE_IMPORT

    working = "Importing the motion"
    # whether the file browser calls `execute`
    _asked = False

    filename_ext = ".npz"
    # not remembered: a path that is there when the operator is called was dropped, and is taken without asking
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in (*OWN_SUFFIXES, *FOREIGN_SUFFIXES)), options={"HIDDEN"}
    )  # type: ignore[valid-type]
    target: bpy.props.EnumProperty(name="Onto", description="Which hand takes it", items=_TARGETS)  # type: ignore[valid-type]
    first_frame: bpy.props.IntProperty(name="First Frame", description="Where the motion begins", default=1)  # type: ignore[valid-type]
    use_scene_range: bpy.props.BoolProperty(
        name="Set Scene Range",
        description="Make the scene's frame range that of the motion",
        default=False,
    )  # type: ignore[valid-type]

    hand: bpy.props.EnumProperty(name="Hand", description="Which hand of the file", items=_HANDS)  # type: ignore[valid-type]
    unit: bpy.props.EnumProperty(name="Unit", description="Length unit of the file", items=_UNITS)  # type: ignore[valid-type]
    hand_length: bpy.props.FloatProperty(
        name="Hand Length",
        description="Scale the hand to this many millimetres, wrist to the middle finger's tip; 0 leaves it",
        min=0.0,
        soft_max=250.0,
        precision=0,
    )  # type: ignore[valid-type]
    part: bpy.props.StringProperty(
        name="Part", description="Which of several skeletons, animations or people: a part of its name"
    )  # type: ignore[valid-type]
    in_place: bpy.props.BoolProperty(
        name="In Place", description="Keep the wrist where it first is: the hand turns and moves on the spot"
    )  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene is None or not context.scene.is_editable:
            return missing(cls, "This scene is linked from another file")
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks for a file, unless one was dropped."""
        if self.filepath and Path(self.filepath).suffix.lower() in DROPPED_SUFFIXES and Path(self.filepath).is_file():
            return super().invoke(context, event)
        self._asked = True
        return ImportHelper.invoke(self, context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """All at once; after the file browser, which forgets an operator that is not done, another one in turns."""
        if not self._asked or context.window is None:
            return super().execute(context)
        self._asked = False
        names = ("filepath", "target", "first_frame", "use_scene_range", *_OF_OTHERS)
        bpy.ops.jghand.import_motion("INVOKE_DEFAULT", **{name: getattr(self, name) for name in names})
        return CANCELLED

    def draw(self, _context: bpy.types.Context) -> None:
        """The options beside the files."""
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(self, "target")
        column.prop(self, "first_frame")
        column.prop(self, "use_scene_range")
        column.separator()
        column.label(text="Files of Other Programs")
        for name in _OF_OTHERS:
            column.prop(self, name)

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """The file is read in a thread, or by the engine, then curve by curve is keyed."""
        path = Path(bpy.path.abspath(self.filepath))
        started = 0.0 if path.suffix.lower() in OWN_SUFFIXES else limits.CONVERSION_PART
        content = yield from self._content(context, path)
        common.object_mode(context)
        hand = self._hand(context, content)
        controlled = hand is not None and controls.has_controls(hand)
        with _controls_off(hand) if controlled else contextlib.nullcontext():
            steps = motion.import_steps(context, content, path.stem, hand=hand, first_frame=self.first_frame)
            done = yield from _from_part(started, steps)
        self._tell(context, content, done, is_new=hand is None, controlled=controlled)

    def _content(self, context: bpy.types.Context, path: Path) -> Generator[float, None, MotionFile]:
        """The motion of a file. One that is not as jghand writes it goes through the engine, where there is one."""
        if path.suffix.lower() in OWN_SUFFIXES:
            try:
                return (yield from aside(partial(read_motion, path)))
            except JGHandFailure as failure:
                if failure.kind != "bad_motion" or not path.is_file() or not _has_engine():
                    raise
        return (yield from self._converted(context, path))

    def _converted(self, context: bpy.types.Context, path: Path) -> Generator[float, None, MotionFile]:
        """The engine's conversion; given up half-way, it is ended and leaves nothing."""
        program, folder = runtime.program(), folders.job_folder()
        hand = "" if self.hand == "AUTO" else self.hand
        choices = ConversionChoices(
            hand=hand,
            unit="" if self.unit == "AUTO" else self.unit,
            hand_length_mm=self.hand_length,
            part=self.part,
            in_place=self.in_place,
        )
        try:
            job = yield from _done(
                Job(JobSpec("motion", self.working, (*program, *words(path, folder, choices)), folder))
            )
            active = common.active_hand(context)
            if job.state.failure is not None and not hand and active is not None:
                # a file that shows both hands, or says nothing of its one: the active hand says which
                again = replace(choices, hand=armature.handedness_of(active))
                job = yield from _done(
                    Job(JobSpec("motion", self.working, (*program, *words(path, folder, again)), folder))
                )
            if job.state.failure is not None:
                kind = "bad_motion" if job.state.failure.kind == "bad_input" else job.state.failure.kind
                raise JGHandFailure(kind, job.state.failure.detail)
            return read_converted(folder)
        finally:
            folders.remove_job_folder(folder)

    def _tell(
        self,
        context: bpy.types.Context,
        content: MotionFile,
        done: motion.ImportedMotion,
        *,
        is_new: bool,
        controlled: bool,
    ) -> None:
        """What follows once all is keyed."""
        told = ""
        if is_new:
            common.link_to_active_collection(context, done.hand)
        elif controlled:
            controls.reset_controls(done.hand)
            controls.mute_controls(done.hand, False)
            controls.use_joint_limits(done.hand, False)
            told = rpt_("Finger controls are neutral and joint limits off, so that the motion is kept exactly.")
        common.make_active(context, done.hand)
        last = self._range(context, content)
        frames = rpt_("{count} frames from {first} to {last} on {name}.").format(
            count=len(content.joints_m), first=self.first_frame, last=last, name=done.hand.name
        )
        if done.notes:
            self.warn(frames, *done.notes, told)
        else:
            self.tell(frames, told)

    def _hand(self, context: bpy.types.Context, content: MotionFile) -> bpy.types.Object | None:
        """The hand that takes the motion; None for a new one."""
        active = common.active_hand(context)
        if self.target == "NEW":
            return None
        if self.target == "ACTIVE" and active is None:
            raise JGHandFailure("not_a_hand", rpt_("no hand is active"))
        fits = active is not None and active.is_editable and armature.handedness_of(active) == content.handedness
        return active if fits or self.target == "ACTIVE" else None

    def _range(self, context: bpy.types.Context, content: MotionFile) -> int:
        """The last whole frame of the motion; the scene's range follows where that is wanted."""
        scene = context.scene
        scene_fps = scene.render.fps / scene.render.fps_base
        last = self.first_frame + round((len(content.joints_m) - 1) * scene_fps / content.fps)
        if self.use_scene_range:
            scene.frame_start, scene.frame_end = self.first_frame, max(last, self.first_frame)
        return last


def _from_part(start: float, steps: Generator[float, None, _Result]) -> Generator[float, None, _Result]:
    """Steps whose part that is done begins at `start`."""
    while True:
        try:
            part = next(steps)
        except StopIteration as end:
            return end.value
        try:
            yield start + (1.0 - start) * part
        except GeneratorExit:
            steps.close()
            raise


def _has_engine() -> bool:
    try:
        return bool(runtime.program())
    except JGHandFailure:
        return False


def _done(job: Job) -> Generator[float, None, Job]:
    """Waits for a job in turns; closed half-way, it is ended."""
    try:
        while not job.wait(limits.ASIDE_LOOK_S):
            # the rest of the work is the keying
            yield limits.CONVERSION_PART * (job.state.fraction or 0.0)
    finally:
        if not job.is_over:
            job.kill()
    return job


class MotionDrop(bpy.types.FileHandler):
    """Motion files dropped into the viewport."""

    bl_idname = "JGHAND_FH_motion"
    bl_label = "JGHand motion"
    bl_import_operator = "jghand.import_motion"
    bl_file_extensions = ";".join(DROPPED_SUFFIXES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Where it may be dropped."""
        return context.area is not None and context.area.type == "VIEW_3D"


@contextlib.contextmanager
def _controls_off(hand: bpy.types.Object) -> Iterator[None]:
    """Without the control layer keys alone move the bones; what else moves them still refuses a motion."""
    rules = {rule: rule.mute for rule in controls.rules_of(hand)}
    controls.mute_controls(hand, True)
    try:
        yield
    finally:
        for rule, muted in rules.items():
            rule.mute = muted


_CLASSES = (ImportMotion, MotionDrop)


def _import_menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    """In Blender's own File > Import."""
    self.layout.operator("jghand.import_motion", text="JGHand Motion (.npz, .json, .csv, .bvh, .glb, .usd, …)")


def register() -> None:
    """Adds the operator, its place in Blender's menu, and what may be dropped."""
    register_classes(_CLASSES)
    register_menu(bpy.types.TOPBAR_MT_file_import, _import_menu)


def unregister() -> None:
    """Takes them away."""
    unregister_menu(bpy.types.TOPBAR_MT_file_import, _import_menu)
    unregister_classes(_CLASSES)
