# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in a video as keys of hands: the engine looks, then their motions are keyed."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from pathlib import Path

import bpy

from .. import ops as common
from ..core import limits
from ..errors import JGHandFailure
from ..renderer import runtime
from . import armature
from .motion_files import MotionFile
from .ops_import import KeysFile
from .seen_hands import avatar_of
from .video_tracking import SUFFIXES, TrackingChoices, fetch_by_hand, read_tracked, words

_HANDS = (
    ("auto", "All Detected", "Every hand in the video, at most one of each side", "NONE", 0),
    ("right", "Right", "The right hand", "NONE", 1),
    ("left", "Left", "The left hand", "NONE", 2),
    ("both", "Both", "Both, or none", "NONE", 3),
)


class TrackVideo(KeysFile, bpy.types.Operator):
    """Operator: the hands in a video, keyed."""

    bl_idname = "jghand.track_video"
    bl_label = "Track Video"
    bl_description = (
        "Find the hands in a video and key their motion, the active hand's or that of new ones. This needs the "
        "training tools; once, where Blender may go online, it downloads 35 MB. Nothing of the video leaves this "
        "machine. Esc cancels"
    )

    working = "Tracking the video"
    verb = "track_video"
    learns = True
    choices = ("hand", "hand_length", "camera_angle", "smoothing", "in_place", "first_frame", "use_scene_range")

    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})  # type: ignore[valid-type]
    hand: bpy.props.EnumProperty(name="Hands", description="Which hands are wanted", items=_HANDS)  # type: ignore[valid-type]
    camera_angle: bpy.props.FloatProperty(
        name="Camera Angle",
        description="Angle of view across the longer edge of the video; 60° to 70° of most telephones",
        default=math.radians(60.0),
        min=math.radians(1.0),
        max=math.radians(150.0),
        precision=3,
        subtype="ANGLE",
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
    use_scene_range: bpy.props.BoolProperty(
        name="Set Scene Range", description="Make the scene's frame range that of the motion", default=True
    )  # type: ignore[valid-type]

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """The engine tracks, then hand by hand and curve by curve is keyed."""
        path = Path(bpy.path.abspath(self.filepath))
        found = yield from self._tracked(context, path)
        many = len(found) > 1
        named = [(content, f"{path.stem} {content.handedness}" if many else path.stem) for content in found]
        yield from self.keying(context, named, limits.TRACKING_PART)

    def _tracked(self, context: bpy.types.Context, path: Path) -> Generator[float, None, tuple[MotionFile, ...]]:
        """The motions of the hands in a video."""
        active = common.active_hand(context)
        wanted = ("auto", "both", armature.handedness_of(active)) if active is not None else ()
        choices = TrackingChoices(
            hand=self.hand,
            hand_length_mm=self.hand_length,
            smoothing=self.smoothing,
            camera_angle_deg=math.degrees(self.camera_angle),
            in_place=self.in_place,
            avatar=avatar_of(active) if active is not None and self.hand in wanted else "",
            fetches=bpy.app.online_access,
        )
        asked = self.made_by_engine(lambda folder: words(path, folder, choices), read_tracked, limits.TRACKING_PART)
        try:
            return (yield from asked)
        except JGHandFailure as failure:
            raise failure if choices.fetches else fetch_by_hand(failure, runtime.program(learns=True)) from failure


CLASSES = (TrackVideo,)
