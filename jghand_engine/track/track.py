"""A video to a motion: look for hands in every picture, tell them apart, fit a hand to what was seen."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import HAND_LENGTH_MAX_M, HAND_LENGTH_MIN_M, check_joint_shape, hand_length
from jghand_engine.hand.sequence import PoseSequence, bone_directions
from jghand_engine.track import CAMERA_ANGLE_DEG
from jghand_engine.track.costs import Trust
from jghand_engine.track.detection import SeenHand
from jghand_engine.track.fit import fit
from jghand_engine.track.hands_over_time import HandOverTime, hands_over_time
from jghand_engine.track.own_hand import own_canonical_joints
from jghand_engine.track.poses import JointChain, Landmarks, Pinhole

# ... and what can be said of one
CAMERA_ANGLES_DEG = (1.0, 150.0)
# beyond this a motion is hardly one any more
SMOOTHING_MAX = 100.0

# of the 20 bones those of the palm come first
FINGER_BONES = slice(5, 20)
_MIRROR = np.array([-1.0, 1.0, 1.0])
# from camera axes (x right, y down, z forward) to those of the motion: y up, z towards the viewer
MOTION_FROM_CAMERA = np.array([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class TrackOptions:
    """What the motion shall be.

    hand_length_m: wrist to middle tip along the bones; None: the avatar's · own_bones: the motion keeps the
    proportions of the hand that was seen, else those of the avatar · smoothing: 1; more is smoother, less is livelier,
    0 takes every frame alone · camera_angle_deg: angle of view across the longer edge of the picture · fill:
    frames without a hand are filled; else their joints are missing
    """

    hand_length_m: float | None = None
    own_bones: bool = False
    smoothing: float = 1.0
    camera_angle_deg: float = CAMERA_ANGLE_DEG
    fill: bool = True

    def check(self) -> None:
        """InputError for what cannot be."""
        length, shortest, longest = self.hand_length_m, HAND_LENGTH_MIN_M, HAND_LENGTH_MAX_M
        if length is not None and not shortest <= length <= longest:
            wanted = f"{1e3 * shortest:g} to {1e3 * longest:g} mm"
            raise InputError("hand length", wanted=wanted, came=f"{1e3 * length:g}")
        if not 0 <= self.smoothing <= SMOOTHING_MAX:
            raise InputError("smoothing", wanted=f"0 to {SMOOTHING_MAX:g}", came=f"{self.smoothing:g}")
        narrow, wide = CAMERA_ANGLES_DEG
        if not narrow <= self.camera_angle_deg <= wide:
            raise InputError(
                "camera angle", wanted=f"{narrow:g} to {wide:g} degrees", came=f"{self.camera_angle_deg:g}"
            )


@dataclass(frozen=True)
class TrackedHand:
    """One hand's motion.

    sequence: the motion; y up, z towards the camera, which is the origin; frames without the hand are filled and marked
    · in_view: (F, 21, 3) the same before the camera, camera axes, meters · seen: (F,) bool · jitter_before_deg,
    jitter_after_deg: `jitter_deg` of what the detector said and of the motion · hand: what was seen
    """

    sequence: PoseSequence
    in_view: np.ndarray
    seen: np.ndarray
    jitter_before_deg: float
    jitter_after_deg: float
    hand: HandOverTime


@dataclass
class Sightings:
    """What a detector saw in every picture of a video; pictures are (height, width)."""

    fps: float
    size_px: tuple[int, int] = (0, 0)
    frames: list[list[SeenHand]] = field(default_factory=list)


def camera_of(sightings: Sightings, angle_deg: float) -> Pinhole:
    """A camera with that angle of view across the longer edge."""
    height, width = sightings.size_px
    focal = max(height, width) / (2 * math.tan(math.radians(angle_deg) / 2))
    return Pinhole(focal, width / 2, height / 2)


def track(
    sightings: Sightings,
    canonical_joints_m: np.ndarray,
    options: TrackOptions | None = None,
    wanted: Mapping[Handedness, HandOverTime] | None = None,
) -> dict[Handedness, TrackedHand]:
    """The motion of each hand that was seen; an empty dictionary when there was none.

    canonical_joints_m: (21, 3) of the avatar, a right hand, level order, meters · wanted: those of `hands_over_time`
    that are wanted; all that are believed.
    """
    options = options or TrackOptions()
    options.check()
    check_joint_shape(canonical_joints_m)
    camera = camera_of(sightings, options.camera_angle_deg)
    found = hands_over_time(sightings.frames, sightings.fps).hands if wanted is None else wanted
    return {side: track_hand(hand, camera, sightings.fps, canonical_joints_m, options) for side, hand in found.items()}


def track_hand(
    hand: HandOverTime, camera: Pinhole, fps: float, canonical_joints_m: np.ndarray, options: TrackOptions
) -> TrackedHand:
    """The motion of one hand."""
    landmarks = landmarks_of(hand, camera, fps)
    length_m = options.hand_length_m or hand_length(canonical_joints_m)
    scaled = canonical_joints_m * (length_m / hand_length(canonical_joints_m))
    own = own_canonical_joints(scaled, landmarks, length_m)
    poses = fit(JointChain.of(own), landmarks, Trust(smoothing=options.smoothing))
    in_view = poses.joints_m(JointChain.of(own if options.own_bones else scaled))
    return tracked(hand, in_view, fps, fill=options.fill)


def tracked(hand: HandOverTime, in_view: np.ndarray, fps: float, *, fill: bool) -> TrackedHand:
    """The motion of a hand whose joints, as a right hand's, are (F, 21, 3) in camera axes, meters. fill: as of
    `TrackOptions`"""
    if hand.handedness is Handedness.LEFT:
        in_view = in_view * _MIRROR
    seen = hand.seen
    raw = np.stack([one.space_m for one in hand.frames if one is not None])
    return TrackedHand(
        sequence_of(in_view, hand.handedness, seen, fps, fill=fill),
        in_view,
        seen,
        jitter_before_deg=jitter_deg(raw),
        jitter_after_deg=jitter_deg(in_view[seen]),
        hand=hand,
    )


def sequence_of(
    in_view: np.ndarray, handedness: Handedness, seen: np.ndarray, fps: float, *, fill: bool = True
) -> PoseSequence:
    """Joints (F, 21, 3) in camera axes, meters, as a motion. seen: (F,) bool · fill: others are marked as filled; else
    their joints are missing"""
    valid = np.broadcast_to((seen | fill)[:, None], in_view.shape[:2])
    return PoseSequence(in_view * MOTION_FROM_CAMERA, fps, handedness, valid, ~seen & fill)


def landmarks_of(hand: HandOverTime, camera: Pinhole, fps: float) -> Landmarks:
    """What was seen, as a right hand's: a left one is mirrored.

    Directions are taken as the detector has them: turned to the ray on which the hand lies they are no nearer.
    """
    count = len(hand.frames)
    image, directions = np.full((count, 21, 2), np.nan), np.full((count, 20, 3), np.nan)
    for frame, seen in enumerate(hand.frames):
        if seen is not None:
            image[frame], directions[frame] = seen.image_px, bone_directions(seen.space_m[None])[0]
    if hand.handedness is Handedness.LEFT:
        image = np.stack([2 * camera.cx - image[..., 0], image[..., 1]], -1)
        directions = directions * _MIRROR
    return Landmarks(image, directions, camera, fps)


def angles_between_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(..., 3) and (..., 3) unit -> (...) degrees."""
    # as exact for small angles as for large ones, which an arc cosine is not
    return np.degrees(2 * np.arctan2(np.linalg.norm(first - second, axis=-1), np.linalg.norm(first + second, axis=-1)))


def jitter_deg(joints_m: np.ndarray) -> float:
    """By how much finger bones typically leave the middle between the frames before and after, degrees.

    The median over frames and bones. A steady motion has little: its speed hardly changes in a frame. NaN for less than
    three frames.
    """
    directions = bone_directions(joints_m)[:, FINGER_BONES]
    middle = directions[:-2] + directions[2:]
    length = np.linalg.norm(middle, axis=-1, keepdims=True)
    if not len(middle):
        return float("nan")
    return float(np.nanmedian(angles_between_deg(directions[1:-1], middle / np.where(length > 0, length, 1.0))))
