# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion files and videos as keys of a hand: one is chosen or dropped, the renderer reads it as a job, hands are keyed.

While the renderer works Blender stays free; given up meanwhile, nothing is changed.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Generator, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import TypeVar

import bpy
import numpy as np

from .. import folders, versions
from .. import ops as common
from ..core.joints import LEFT, RIGHT, WRIST
from ..core.panel_text import in_blenders_words
from ..core.view import avatar_stamp
from ..errors import JGHandFailure
from ..ops import UNDOABLE_IMPORT, FromFile, followed, poll_scene
from ..render.camera import add_film_camera
from ..renderer import runtime
from ..renderer.jobs import JobSpec
from . import armature, controls, motion
from .motion import WantedMotion
from .motion_files import (
    FETCH,
    FPS_MAX,
    MOTION_FIELDS,
    MOTION_SUFFIXES,
    ORDERS,
    VIDEO_FIELDS,
    VIDEO_SUFFIXES,
    WANTS_HAND,
    MotionFile,
    TrackedFilm,
    near_hand,
    read_converted,
    read_motion,
    read_tracked,
    words,
)
from .seen_hands import avatar_of

_Result = TypeVar("_Result")
# what was asked of the video that was tracked last, and what was found in it
_last_film: tuple[tuple, TrackedFilm] | None = None

# Blender's own importers take glTF and USD that are dropped
DROPPED_SUFFIXES = (".npz", ".json", ".csv", ".npy", ".bvh")
_TARGETS = (
    ("AUTO", "Active or New", "The active hand, where it is of the motion's side; else a new one", "NONE", 0),
    ("ACTIVE", "Active Hand", "The active hand only", "NONE", 1),
    ("NEW", "New Hand", "A new hand with the bone lengths of the motion", "NONE", 2),
)

_HANDS = (
    ("AUTO", "From File", "Where the file names none or both, the one that fits the active hand", "NONE", 0),
    ("right", "Right", "The right hand of the file", "NONE", 1),
    ("left", "Left", "The left hand of the file", "NONE", 2),
)
_UNITS = (
    ("AUTO", "Automatic", "As the file says, else recognized by the size of the hand", "NONE", 0),
    ("m", "Meters", "The file's unit", "NONE", 1),
    ("cm", "Centimeters", "The file's unit", "NONE", 2),
    ("mm", "Millimeters", "The file's unit", "NONE", 3),
)


_ORDERS = (
    ("AUTO", "Automatic", "As the file says, else recognized by the bones", "NONE", 0),
    *(
        (name, label, "Order in which the file lists the joints", "NONE", n)
        for n, (name, label) in enumerate(ORDERS, 1)
    ),
)

_UPS = (
    ("AUTO", "Automatic", "As the file or its format says", "NONE", 0),
    ("y", "Y", "The file has y up", "NONE", 1),
    ("z", "Z", "The file has z up", "NONE", 2),
)
_LABELS = (
    ("AUTO", "Automatic", "As is usual for the detector; where fingers bend, they show it", "NONE", 0),
    ("true", "True", "A right hand is labeled right", "NONE", 1),
    ("mirrored", "Mirrored", "A right hand is labeled left, as in a mirror", "NONE", 2),
)

# options that go to the renderer; where one of them is chosen, it reads jghand's own files too
_OF_OTHERS = ("hand", "unit", "order", "fps", "hand_length", "part", "up", "labels", "bones", "mirror")


_TRACKED_HANDS = (
    ("auto", "All Detected", "Every hand in the video, at most one of each side", "NONE", 0),
    ("right", "Right", "The right hand", "NONE", 1),
    ("left", "Left", "The left hand", "NONE", 2),
    ("both", "Both", "Both, or none", "NONE", 3),
)
_FILM_TIP = (
    "As the film shows it: adds its camera with the film behind the hand. The scene takes its size and frame rate"
)
_IN_FILE_TIP = "The wrist moves as in the file, whose origin is where the hand is, or the world's of a new one"
# where there is no hand yet, the wrist of a new one is where the file has it
_PLACEMENTS_OF_FILES = (
    ("FROM_HAND", "From the Hand", "The wrist begins where the hand is, and moves as in the file", "NONE", 0),
    ("IN_PLACE", "In Place", "The wrist stays where it begins: the hand turns and bends on the spot", "NONE", 1),
    ("FILE", "As in the File", _IN_FILE_TIP, "NONE", 2),
)
_PLACEMENTS_OF_FILMS = (
    ("IN_PLACE", "In Place", "The wrist stays where the hand is: it turns and bends on the spot", "NONE", 0),
    ("FROM_HAND", "From the Hand", "The wrist begins where the hand is, and moves as it did in the film", "NONE", 1),
    ("FILM", "Film Camera", _FILM_TIP, "NONE", 2),
)


class KeysFile(FromFile):
    """An operator that makes keys of a file. `learns`: whether the engine needs PyTorch for it."""

    bl_options = UNDOABLE_IMPORT
    learns = False

    first_frame: bpy.props.IntProperty(name="First Frame", description="Where the motion begins", default=1)
    use_scene_rate: bpy.props.BoolProperty(
        name="Set Frame Rate",
        description="Make the scene's frame rate that of the motion, so that all its keys are on whole frames; else "
        "the motion keeps its speed at the scene's rate",
    )

    poll = classmethod(poll_scene)

    def hand_for(self, context: bpy.types.Context, content: MotionFile) -> bpy.types.Object | None:
        """The hand that takes a motion: the active one, where it is of the motion's side; None for a new one."""
        active = common.active_hand(context)
        fits = active is not None and active.is_editable and armature.shown_handedness(active) == content.handedness
        return active if fits else None

    def made_by_engine(
        self, said: Callable[[Path], Sequence[str]], read: Callable[[Path], _Result]
    ) -> Generator[float, None, _Result]:
        """What `read` finds in a folder, after the renderer has done there what it is `said` to. Closed half-way, the
        renderer is asked to end and leaves nothing. JGHandFailure: why it failed."""
        runtime.jobs.refuse_second(runtime.IMPORT)
        program, folder = runtime.program(learns=self.learns), folders.job_folder()
        results: list[_Result] = []
        spec = JobSpec(
            self.working,
            (*program, *said(folder)),
            on_done=lambda: results.append(read(folder)),
            scratch=(folder,),
        )
        job = runtime.start_job(runtime.IMPORT, spec)
        try:
            yield from followed(job)
        finally:
            if not job.is_over:
                job.cancel()
                if not runtime.timers_fire():
                    job.kill()
        return results[0]

    def wanted(self, context: bpy.types.Context, contents: Sequence[tuple[MotionFile, str]]) -> list[WantedMotion]:
        """Motions, each with its name and the hand that takes it."""
        return [WantedMotion(content, name, self.hand_for(context, content)) for content, name in contents]

    def keying(
        self,
        context: bpy.types.Context,
        wanted: Sequence[WantedMotion],
        *,
        origin_m: np.ndarray | None = None,
        set_rate: bool = False,
    ) -> list[str]:
        """Keys motions, and says in sentences what was done; where one of them is refused, none is keyed. origin_m,
        set_rate: as `motion.import_motions` takes them."""
        common.object_mode(context)
        controlled = [one.hand for one in wanted if one.hand is not None and controls.has_controls(one.hand)]
        with common.wait_cursor(context):
            hands = motion.import_motions(
                context,
                wanted,
                first_frame=self.first_frame,
                origin_m=origin_m,
                set_rate=set_rate or self.use_scene_rate,
            )
        for one, hand in zip(wanted, hands, strict=True):
            if one.hand is None:
                common.link_to_active_collection(context, hand)
            common.make_active(context, hand)
            versions.select_bones(hand)
        for hand in controlled:
            controls.reset_controls(hand)
            controls.mute_controls(hand, False)
            controls.use_joint_limits(hand, False)
        scene_rate = motion.frame_rate(context.scene)
        lines, lasts = [], [self.first_frame]
        for one, hand in zip(wanted, hands, strict=True):
            frames = len(one.motion.joints_m)
            lasts.append(self.first_frame + round((frames - 1) * scene_rate / one.motion.fps))
            lines.append(f"{frames} frames from {self.first_frame} to {lasts[-1]} on {hand.name}.")
        if self.use_scene_range:
            context.scene.frame_start, context.scene.frame_end = self.first_frame, max(lasts)
        if controlled:
            lines.append("Finger controls are neutral and joint limits off, so that the motion is kept exactly.")
        return lines

    def conclude(self, done: Sequence[str], wanted: Sequence[WantedMotion], *doubts: str) -> None:
        """Tells what was done, and warns of what was repaired and of `doubts`."""
        notes = list(dict.fromkeys(note for one in wanted for note in one.motion.notes)) + list(doubts)
        stiff = [
            one.hand.name
            for one in wanted
            if one.hand is not None and one.motion.forearm is not None and not armature.has_forearm_bone(one.hand)
        ]
        if stiff:
            notes.append(f"The turn of the forearm is left out on {', '.join(stiff)}: its bones are shared, or linked.")
        self.tell(*done, doubts=notes)


class ImportMotion(KeysFile, bpy.types.Operator):
    bl_idname = "jghand.import_motion"
    bl_label = "Import Motion"
    bl_description = (
        "Key a motion on the active hand or on a new one: JGHand's own files, BVH, USD, and joints of OpenPose, "
        "MediaPipe, FreeMoCap and headsets. The action before it stays in the file. Esc cancels"
    )

    working = "Importing the motion"
    choices = ("target", "placement", "first_frame", "use_scene_range", "use_scene_rate", *_OF_OTHERS)
    headings = MappingProxyType({_OF_OTHERS[0]: "Files of Other Programs"})

    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in MOTION_SUFFIXES), options={"HIDDEN"}
    )
    target: bpy.props.EnumProperty(name="Target", description="Which hand takes it", items=_TARGETS)
    placement: bpy.props.EnumProperty(
        name="Placement", description="Where the hand is in the scene", items=_PLACEMENTS_OF_FILES, default="FROM_HAND"
    )
    use_scene_range: bpy.props.BoolProperty(
        name="Set Scene Range",
        description="Make the scene's frame range that of the motion",
    )

    hand: bpy.props.EnumProperty(name="Hand", description="Which hand of the file", items=_HANDS)
    unit: bpy.props.EnumProperty(name="Unit", description="Length unit of the file", items=_UNITS)
    order: bpy.props.EnumProperty(name="Order", description="Order of the joints in the file", items=_ORDERS)
    fps: bpy.props.FloatProperty(
        name="Frame Rate",
        description="Frames per second of the file; 0: as it says, else 30",
        min=0.0,
        max=FPS_MAX,
        soft_max=240.0,
        precision=2,
    )
    part: bpy.props.StringProperty(
        name="Part", description="Which of several skeletons, animations or people: a part of its name"
    )
    up: bpy.props.EnumProperty(name="Up", description="The axis that points up in the file", items=_UPS)
    labels: bpy.props.EnumProperty(
        name="Labels", description="Whether a detector's Left and Right are true", items=_LABELS
    )
    bones: bpy.props.StringProperty(
        name="Bone Names",
        description="A JSON file with the names of a rig's bones by joint, for names that are not recognized",
        subtype="FILE_PATH",
    )
    mirror: bpy.props.BoolProperty(name="Mirror", description="Make it the motion of the other hand")

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        path = Path(bpy.path.abspath(self.filepath))
        content = yield from self._content(context, path)
        (one,) = self.wanted(context, [(content, path.stem)])
        if self.placement != "FILE":
            (near,) = near_hand([content], 0, in_place=self.placement == "IN_PLACE")
            begins_m = content.joints_m[0, WRIST] if one.hand is None else 0.0
            one = replace(one, motion=replace(near, joints_m=near.joints_m + begins_m))
        self.conclude(self.keying(context, [one]), [one])

    def said(self) -> dict[str, str | bool]:
        """What was chosen beside the file, in the renderer's words."""
        chosen = {
            "--hand": self.hand,
            "--unit": self.unit,
            "--order": self.order,
            "--file-up": self.up,
            "--labels": self.labels,
            "--fps": f"{self.fps:g}" if self.fps else "",
            "--hand-length": f"{self.hand_length:g}" if self.hand_length else "",
            "--part": self.part,
            "--bones": bpy.path.abspath(self.bones),
            "--mirror": self.mirror,
        }
        return {option: "" if value == "AUTO" else value for option, value in chosen.items()}

    def hand_for(self, context: bpy.types.Context, content: MotionFile) -> bpy.types.Object | None:
        """As `target` says."""
        if self.target == "AUTO":
            return super().hand_for(context, content)
        active = common.active_hand(context)
        if self.target == "ACTIVE" and active is None:
            raise JGHandFailure("not_a_hand", "no hand is active")
        return active if self.target == "ACTIVE" else None

    def _content(self, context: bpy.types.Context, path: Path) -> Generator[float, None, MotionFile]:
        """The motion of a file. One that is not as jghand writes it goes through the renderer, and so does one that
        shall become something else than it is."""
        options = self.said()
        if path.suffix.lower() == ".npz" and not any(options.values()):
            with contextlib.suppress(JGHandFailure):  # the renderer reads more, and says what it cannot
                return read_motion(path)
        try:
            return (yield from self._converted(path, options))
        except JGHandFailure as failure:
            active = common.active_hand(context)
            if failure.kind != "bad_motion" or WANTS_HAND not in failure.log or active is None:
                raise
        # a file that shows both hands, or says nothing of its one: that which becomes one of the active hand's side
        side = armature.shown_handedness(active)
        if self.mirror:
            side = LEFT if side == RIGHT else RIGHT
        return (yield from self._converted(path, {**options, "--hand": side}))

    def _converted(self, path: Path, options: dict[str, str | bool]) -> Generator[float, None, MotionFile]:
        """What the renderer makes of it. JGHandFailure (bad_motion) where the file is refused, in the words of what
        stands beside it."""
        try:
            return (
                yield from self.made_by_engine(lambda folder: words("motion", path, folder, options), read_converted)
            )
        except JGHandFailure as failure:
            if failure.kind != "bad_input":
                raise
            detail = in_blenders_words(failure.detail, MOTION_FIELDS)
            raise JGHandFailure("bad_motion", detail, log=f"{failure.detail}\n{failure.log}") from failure


class TrackVideo(KeysFile, bpy.types.Operator):
    bl_idname = "jghand.track_video"
    bl_label = "Track Video"
    bl_description = (
        "Find the hands in a video and key their motion, the active hand's or that of new ones. This needs the "
        "training tools; once, where Blender may go online, it downloads 35 MB. Nothing of the video leaves this "
        "machine. Esc cancels"
    )

    working = "Tracking the video"
    learns = True
    choices = (
        *("hand", "hand_length", "camera_angle", "exact", "smoothing", "placement"),
        *("first_frame", "use_scene_range", "use_scene_rate"),
    )

    filter_glob: bpy.props.StringProperty(
        default=";".join(f"*{suffix}" for suffix in VIDEO_SUFFIXES), options={"HIDDEN"}
    )
    hand: bpy.props.EnumProperty(name="Hands", description="Which hands are wanted", items=_TRACKED_HANDS)
    camera_angle: bpy.props.FloatProperty(
        name="Camera Angle",
        description="Angle of view across the longer edge of the video; 63° to 70° of most telephones",
        default=math.radians(66.0),
        min=math.radians(1.0),
        max=math.radians(150.0),
        precision=3,
        subtype="ANGLE",
    )
    exact: bpy.props.BoolProperty(
        name="Exact",
        description="Fit a hand to outlines and colors too: minutes instead of seconds, and fingers are nearer. Of one "
        "hand in at most 900 frames; it has a smoothing of its own",
    )
    smoothing: bpy.props.FloatProperty(
        name="Smoothing",
        description="More is smoother, less is livelier; it never lags",
        default=1.0,
        min=0.0,
        max=100.0,
    )
    placement: bpy.props.EnumProperty(
        name="Placement", description="Where the hand is in the scene", items=_PLACEMENTS_OF_FILMS, default="IN_PLACE"
    )
    use_scene_range: bpy.props.BoolProperty(
        name="Set Scene Range", description="Make the scene's frame range that of the motion", default=True
    )

    def steps(self, context: bpy.types.Context) -> Generator[float, None, None]:
        path = Path(bpy.path.abspath(self.filepath))
        film = yield from self._tracked(context, path)
        many = len(film.motions) > 1
        named = [(content, f"{path.stem} {content.handedness}" if many else path.stem) for content in film.motions]
        wanted = self.wanted(context, named)
        if self.placement != "FILM":
            anchor = next((place for place, one in enumerate(wanted) if one.hand is not None), None)
            near = near_hand(film.motions, anchor, in_place=self.placement == "IN_PLACE")
            wanted = [replace(one, motion=content) for one, content in zip(wanted, near, strict=True)]
            hand = None if anchor is None else wanted[anchor].hand
            stands = np.zeros(3) if hand is None else np.array(hand.matrix_world.translation, dtype=np.float64)
            origin_m = context.scene.unit_settings.scale_length * stands
            self.conclude(self.keying(context, wanted, origin_m=origin_m), wanted)
            return
        done = self.keying(context, wanted, origin_m=np.zeros(3), set_rate=True)
        camera, is_behind = add_film_camera(context, path, film.size_px, self.camera_angle, self.first_frame)
        common.link_to_active_collection(context, camera)
        if context.area is not None and context.area.type == "VIEW_3D":
            context.area.spaces.active.region_3d.view_perspective = "CAMERA"
        text = f"{camera.name} sees as the film's camera did; the scene has the film's size and frame rate."
        doubts = [] if is_behind else ["This Blender cannot play the film, so it is not behind the hand."]
        self.conclude([*done, text], wanted, *doubts)

    def _tracked(self, context: bpy.types.Context, path: Path) -> Generator[float, None, TrackedFilm]:
        """The motions of the hands in a video. What was found last is kept: another placement is no reason to look
        again."""
        global _last_film
        active = common.active_hand(context)
        wanted = ("auto", "both", armature.shown_handedness(active)) if active is not None else ()
        avatar = avatar_of(active) if active is not None and self.hand in wanted else ""
        options = {
            "--hand": self.hand,
            "--exact": self.exact,
            "--smoothing": f"{self.smoothing:g}",
            "--camera-angle": f"{math.degrees(self.camera_angle):g}",
            "--hand-length": f"{self.hand_length:g}" if self.hand_length else "",
            "--avatar": avatar,
            FETCH: bpy.app.online_access,
        }
        state = path.stat() if path.is_file() else None
        stamp = avatar and avatar_stamp(avatar)
        asked = (path, state and (state.st_mtime_ns, state.st_size), stamp, tuple(options.items()))
        if _last_film is not None and _last_film[0] == asked:
            return _last_film[1]
        try:
            film = yield from self.made_by_engine(lambda folder: words("track", path, folder, options), read_tracked)
        except JGHandFailure as failure:
            if FETCH in failure.detail and not options[FETCH]:
                raise JGHandFailure("offline", log=failure.log) from failure
            raise JGHandFailure(
                failure.kind, in_blenders_words(failure.detail, VIDEO_FIELDS), log=failure.log
            ) from failure
        _last_film = (asked, film)
        return film


class MotionDrop(bpy.types.FileHandler):
    bl_idname = "JGHAND_FH_motion"
    bl_label = "JGHand motion"
    bl_import_operator = "jghand.import_motion"
    bl_file_extensions = ";".join(DROPPED_SUFFIXES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        return context.area is not None and context.area.type == "VIEW_3D"


CLASSES = (ImportMotion, TrackVideo, MotionDrop)


def _import_menu(self: bpy.types.Menu, _context: bpy.types.Context) -> None:
    self.layout.operator("jghand.import_motion", text="JGHand Motion (.npz, .json, .csv, .bvh, .usd, …)")


MENUS = ((bpy.types.TOPBAR_MT_file_import, _import_menu),)
