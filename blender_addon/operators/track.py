# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in a video as keys of hands: the engine looks, then their motions are keyed."""

from __future__ import annotations

from collections.abc import Generator, Iterator
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_rpt as rpt_
from bpy_extras.io_utils import ImportHelper

from .. import runtime
from ..bridge import armature, controls, folders, motion
from ..bridge.classes import register_classes, unregister_classes
from ..core import limits
from ..core.jobs import Job, JobSpec
from ..core.motion_files import MotionFile
from ..core.video_tracking import SUFFIXES, TrackingChoices, read_tracked, words
from . import common
from .common import CANCELLED, UNDOABLE_IMPORT, InTurns, missing

_HANDS = (
    ("auto", "All That Are Seen", "Every hand in the video, one of each side at most", "NONE", 0),
    ("right", "Right", "The right hand", "NONE", 1),
    ("left", "Left", "The left hand", "NONE", 2),
    ("both", "Both", "Both, or none", "NONE", 3),
)
_CHOICES = ("hand", "hand_length", "camera_angle", "smoothing", "in_place", "first_frame", "use_scene_range")


class TrackVideo(InTurns, ImportHelper, bpy.types.Operator):
    """Operator: the hands in a video, keyed."""

    bl_idname = "jghand.track_video"
    bl_label = "Track Video"
    bl_description = (
        "Find the hands in a video and key their motion, the active hand's or that of new ones. The engine needs its "
        "extra track; networks of 8 MB are fetched once. Nothing leaves this machine. Esc cancels"
    )
    bl_options = UNDOABLE_IMPORT

    working = "Tracking the video"
    # whether the file browser calls `execute`
    _asked = False

    filename_ext = ""
    filepath: bpy.props.StringProperty(subtype="FILE_PATH", options={"SKIP_SAVE"})  # type: ignore[valid-type]
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})  # type: ignore[valid-type]
    hand: bpy.props.EnumProperty(name="Hands", description="Which hands are wanted", items=_HANDS)  # type: ignore[valid-type]
    hand_length: bpy.props.FloatProperty(
        name="Hand Length",
        description="Length of the true hand in millimetres, wrist to the middle finger's tip; 0: that of the avatar",
        min=0.0,
        soft_max=250.0,
        precision=0,
    )  # type: ignore[valid-type]
    camera_angle: bpy.props.FloatProperty(
        name="Camera Angle",
        description="Angle of view across the longer edge of the video, degrees; 60 to 70 of most telephones",
        default=60.0,
        min=1.0,
        max=150.0,
        precision=0,
    )  # type: ignore[valid-type]
    smoothing: bpy.props.FloatProperty(
        name="Smoothing",
        description="More is smoother, less is livelier; it never lags",
        default=1.0,
        min=0.0,
        max=100.0,
    )  # type: ignore[valid-type]
    in_place: bpy.props.BoolProperty(
        name="In Place", description="Keep the wrist at the origin; else the hand moves as before the camera"
    )  # type: ignore[valid-type]
    first_frame: bpy.props.IntProperty(name="First Frame", description="Where the motion begins", default=1)  # type: ignore[valid-type]
    use_scene_range: bpy.props.BoolProperty(
        name="Set Scene Range", description="Make the scene's frame range that of the motion", default=True
    )  # type: ignore[valid-type]

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if context.scene is None or not context.scene.is_editable:
            return missing(cls, "This scene is linked from another file")
        return True

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks for a file, unless one is named."""
        if self.filepath and Path(self.filepath).is_file():
            return super().invoke(context, event)
        self._asked = True
        return ImportHelper.invoke(self, context, event)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """All at once; after the file browser, which forgets an operator that is not done, another one in turns."""
        if not self._asked or context.window is None:
            return super().execute(context)
        self._asked = False
        bpy.ops.jghand.track_video("INVOKE_DEFAULT", **{name: getattr(self, name) for name in ("filepath", *_CHOICES)})
        return CANCELLED

    def draw(self, _context: bpy.types.Context) -> None:
        """The options beside the files."""
        column = self.layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        for name in _CHOICES:
            column.prop(self, name)

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """The engine tracks, then hand by hand and curve by curve is keyed."""
        path = Path(bpy.path.abspath(self.filepath))
        found = yield from self._tracked(path)
        common.object_mode(context)
        active = common.active_hand(context)
        lines: list[str] = []
        notes: list[str] = []
        for number, content in enumerate(found):
            hand = active if _takes(active, content) else None
            name = path.stem if len(found) == 1 else f"{path.stem} {content.handedness}"
            steps = motion.import_steps(context, content, name, hand=hand, first_frame=self.first_frame)
            done = yield from _scaled(steps, number, len(found))
            if hand is None:
                common.link_to_active_collection(context, done.hand)
            common.make_active(context, done.hand)
            lines.append(
                rpt_("{count} frames from {first} to {last} on {name}.").format(
                    count=len(content.joints_m),
                    first=self.first_frame,
                    last=self._last(context, content),
                    name=done.hand.name,
                )
            )
            notes += [*done.notes, *content.notes]
        if self.use_scene_range:
            scene = context.scene
            scene.frame_start = self.first_frame
            scene.frame_end = max(self.first_frame, *(self._last(context, content) for content in found))
        told = " ".join(lines)
        distinct = list(dict.fromkeys(notes))
        if distinct:
            self.warn(told, *distinct)
        else:
            self.tell(told)

    def _tracked(self, path: Path) -> Generator[float, None, tuple[MotionFile, ...]]:
        """The motions of the hands in a video; given up half-way, the engine's work is ended and leaves nothing."""
        program, folder = runtime.program(), folders.job_folder()
        choices = TrackingChoices(
            hand=self.hand,
            hand_length_mm=self.hand_length,
            smoothing=self.smoothing,
            camera_angle_deg=self.camera_angle,
            in_place=self.in_place,
        )
        try:
            job = Job(JobSpec("track", self.working, (*program, *words(path, folder, choices)), folder))
            try:
                while not job.wait(limits.ASIDE_LOOK_S):
                    yield limits.TRACKING_PART * (job.state.fraction or 0.0)
            finally:
                if not job.is_over:
                    job.kill()
            if job.state.failure is not None:
                raise job.state.failure
            return read_tracked(folder)
        finally:
            folders.remove_job_folder(folder)

    def _last(self, context: bpy.types.Context, content: MotionFile) -> int:
        """The last frame of a motion in the scene."""
        scene_fps = context.scene.render.fps / context.scene.render.fps_base
        return self.first_frame + round((len(content.joints_m) - 1) * scene_fps / content.fps)


def _takes(hand: bpy.types.Object | None, content: MotionFile) -> bool:
    """Whether a motion is for the active hand: of its side, without controls that would have to be taken off it."""
    if hand is None or not hand.is_editable or controls.has_controls(hand):
        return False
    return armature.handedness_of(hand) == content.handedness


def _scaled(
    steps: Generator[float, None, motion.ImportedMotion], number: int, count: int
) -> Generator[float, None, motion.ImportedMotion]:
    """Steps of one of several motions, whose part that is done begins where the engine's ends."""
    rest = 1.0 - limits.TRACKING_PART
    try:
        while True:
            try:
                part = next(steps)
            except StopIteration as end:
                return end.value
            yield limits.TRACKING_PART + rest * (number + part) / count
    finally:
        steps.close()


def register() -> None:
    """Adds the operator."""
    register_classes((TrackVideo,))


def unregister() -> None:
    """Takes it away."""
    unregister_classes((TrackVideo,))
