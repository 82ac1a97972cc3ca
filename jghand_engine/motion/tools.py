"""What is done to motions on their way in: cutting, taking them at other times, scaling, turning. Knows no files.

Another frame rate is `PoseSequence.resampled`, the other hand `PoseSequence.mirrored`, part of the frames `.section`.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import HAND_LENGTH_MAX_M, HAND_LENGTH_MIN_M, hand_length
from jghand_engine.hand.sequence import FRAME_EPS, PoseSequence, poses_at
from jghand_engine.motion.clocks import STEP_JITTER_MAX

# steps of a clock longer than so many usual ones are holes: nobody saw what is in them
CLOCK_HOLE_STEPS = 1.5
# where an axis stands that points up, as a turn about x from y
_UP_DEG = {"y": 0, "z": 90, "-y": 180}


def cut(sequence: PoseSequence, start_s: float | None = None, end_s: float | None = None) -> PoseSequence:
    """The frames from `start_s` to `end_s`, seconds from the beginning, both included. InputError when none is left."""
    for name, seconds in (("start", start_s), ("end", end_s)):
        if seconds is not None and not (math.isfinite(seconds) and seconds >= 0):
            raise InputError(f"{name} of the cut", wanted="seconds from the motion's beginning", came=f"{seconds:g}")
    # a time that is a frame but for round-off is that frame
    first = 0 if start_s is None else math.ceil(start_s * sequence.fps - FRAME_EPS)
    last = len(sequence) - 1 if end_s is None else math.floor(min(end_s * sequence.fps, len(sequence)) + FRAME_EPS)
    if first > min(last, len(sequence) - 1):
        raise InputError(
            "cut",
            wanted=f"a part of the motion's {sequence.duration_s:.2f} s",
            came=f"{start_s or 0:g} s to {sequence.duration_s if end_s is None else end_s:g} s",
        )
    return sequence.section(first, last + 1)


def retimed(joints: np.ndarray, times_s: np.ndarray, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """(F, 21, 3) level-order joints seen at `times_s` (F,), rising -> (G, 21, 3) at an even rate from the first on, and
    their places (G,) among the F.

    fps: that of the usual step. A frame between a pose and a missing one is missing, and so is one inside a hole: a
    step of more than CLOCK_HOLE_STEPS usual ones. InputError for times that do not rise.
    """
    steps_s = np.diff(times_s)
    if not np.isfinite(times_s).all() or (steps_s <= 0).any():
        raise InputError("times of a motion", wanted="times that rise from frame to frame", came="others")
    wanted_s = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * fps + FRAME_EPS) + 1) / fps
    places = np.interp(wanted_s, times_s, np.arange(len(times_s)))
    result = poses_at(joints, places)
    if len(steps_s):
        before = np.minimum(places.astype(np.int64), len(steps_s) - 1)
        away_s = np.minimum(wanted_s - times_s[before], times_s[before + 1] - wanted_s)
        in_hole = steps_s[before] > CLOCK_HOLE_STEPS / fps
        result[in_hole & (away_s > STEP_JITTER_MAX / fps)] = np.nan
    return result, places


def in_place(sequence: PoseSequence) -> PoseSequence:
    """The same motion with the wrist kept where it first was: the hand turns and its fingers move on the spot.

    Frames without a wrist are left as they are.
    """
    seen = np.flatnonzero(sequence.valid[:, 0])
    if not len(seen):
        return sequence
    moved = sequence.joints_m[:, :1] - sequence.joints_m[seen[0], 0]
    moved[~sequence.valid[:, 0]] = 0.0
    return dataclasses.replace(sequence, joints_m=sequence.joints_m - moved, valid=sequence.valid)


def turned_up(sequence: PoseSequence, up: str, wanted: str) -> PoseSequence:
    """The motion turned about x so that its axis `up` becomes `wanted`; both of "y", "z", "-y"."""
    joints_m = sequence.joints_m @ up_rotation(up, wanted).T
    return dataclasses.replace(sequence, joints_m=joints_m, valid=sequence.valid)


def up_rotation(up: str, wanted: str) -> np.ndarray:
    """(3, 3) the rotation about x that lays the axis `up` on `wanted`; both of "y", "z", "-y"."""
    turn = math.radians(_UP_DEG[wanted] - _UP_DEG[up])
    # quarter turns, exactly
    cosine, sine = round(math.cos(turn)), round(math.sin(turn))
    return np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]], dtype=np.float64)


def with_hand_length(sequence: PoseSequence, length_m: float) -> PoseSequence:
    """The motion scaled so that the chain from the wrist to the middle finger's tip has `length_m` meters (median)."""
    if not (math.isfinite(length_m) and HAND_LENGTH_MIN_M <= length_m <= HAND_LENGTH_MAX_M):
        wanted = f"{HAND_LENGTH_MIN_M:g} to {HAND_LENGTH_MAX_M:g} m"
        raise InputError("length of the hand", wanted=wanted, came=f"{length_m:g} m")
    factor = length_m / hand_length(sequence.joints_m)
    return dataclasses.replace(sequence, joints_m=sequence.joints_m * factor, valid=sequence.valid)
