"""What is done to motions on their way in: filling gaps, cutting, taking them at other times, scaling. Knows no files.

Everything here turns bones and keeps their lengths: interpolating positions would shorten fingers on the way. Another
frame rate is `PoseSequence.resampled`, the other hand `PoseSequence.mirrored`, part of the frames `.section`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
import torch

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, JOINT_COUNT, LEVEL_NAMES, PARENTS
from jghand_engine.hand.orders import hand_length
from jghand_engine.hand.rotations import slerp
from jghand_engine.hand.sequence import GapReport, PoseSequence, alignment, palm_frames, poses_at, rotations_between

# where an axis stands that points up, as a turn about x from y
_UP_DEG = {"y": 0, "z": 90, "-y": 180}
# the base of the thumb and the knuckles, which move little in the palm
_KNUCKLES = slice(1, 6)


@dataclass(frozen=True)
class FilledMotion:
    """A whole motion, whose frames with a gap count as `filled`, and what was missing in it."""

    sequence: PoseSequence
    gaps: GapReport

    def sentence(self) -> str:
        """One line for people; '' when nothing was missing."""
        if not self.gaps:
            return ""
        longest_s = self.gaps.longest / self.sequence.fps
        text = (
            f"{self.gaps.sentence()}: they were filled by turning the bones evenly from what was seen before to what "
        )
        text += "was seen after."
        if longest_s > limits.GAP_LONG_S:
            text += f" The longest gap has {longest_s:.1f} s: what the hand did there is not known."
        return text


def fill_gaps(sequence: PoseSequence) -> FilledMotion:
    """Every missing joint from the frames before and after; joints that were seen are not moved.

    A bone's direction goes along the great circle inside the palm, which itself turns the short way, its length
    linearly; before the first and after the last frame that shows it a bone keeps its place in the palm. Joints missing
    between two that were seen bend there so that all bones keep their lengths, as far as what was seen lets them. The
    wrist lies to the knuckles as it did; where one of them is missing too it goes linearly. InputError when the wrist
    or a bone is in no frame.
    """
    valid, joints = sequence.valid, sequence.joints_m.copy()
    if valid.all():
        return FilledMotion(sequence, sequence.gaps)
    joints[:, 0] = _wrist(joints, valid)
    palms, has_palm = _palms(sequence.joints_m)
    lengths = _lengths(sequence.bone_lengths_m)
    for joint in range(1, JOINT_COUNT):
        lost = np.flatnonzero(~valid[:, joint])
        if not len(lost):
            continue
        parent = PARENTS[joint]
        seen = valid[:, joint] & valid[:, parent]
        # where the palm was seen too its turning is known; else the bone is taken as it is
        known = np.flatnonzero(seen & has_palm if (seen & has_palm).any() else seen)
        if not len(known):
            raise _never_seen(sequence, LEVEL_NAMES[joint])
        bones = sequence.joints_m[known, joint] - sequence.joints_m[known, parent]
        inside = np.einsum("fji,fj->fi", palms[known], bones)
        joints[lost, joint] = joints[lost, parent] + np.einsum(
            "fij,fj->fi", palms[lost], _vectors_at(known, inside, lost)
        )
        _reach(joints, valid, lengths, joint)
    filled = sequence.filled | ~valid.all(axis=1)
    whole = dataclasses.replace(sequence, joints_m=joints, valid=np.ones_like(valid), filled=filled)
    return FilledMotion(whole, sequence.gaps)


def cut(sequence: PoseSequence, start_s: float | None = None, end_s: float | None = None) -> PoseSequence:
    """The frames from `start_s` to `end_s`, seconds from the beginning, both included. InputError when none is left."""
    for name, seconds in (("start", start_s), ("end", end_s)):
        if seconds is not None and not (math.isfinite(seconds) and seconds >= 0):
            raise InputError(f"{name} of the cut", wanted="seconds from the motion's beginning", came=f"{seconds:g}")
    # a time that is a frame but for round-off is that frame
    first = 0 if start_s is None else math.ceil(start_s * sequence.fps - limits.FRAME_EPS)
    last = (
        len(sequence) - 1 if end_s is None else math.floor(min(end_s * sequence.fps, len(sequence)) + limits.FRAME_EPS)
    )
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
    wanted_s = times_s[0] + np.arange(int((times_s[-1] - times_s[0]) * fps + limits.FRAME_EPS) + 1) / fps
    places = np.interp(wanted_s, times_s, np.arange(len(times_s)))
    result = poses_at(joints, places)
    if len(steps_s):
        before = np.minimum(places.astype(np.int64), len(steps_s) - 1)
        away_s = np.minimum(wanted_s - times_s[before], times_s[before + 1] - wanted_s)
        in_hole = steps_s[before] > limits.CLOCK_HOLE_STEPS / fps
        result[in_hole & (away_s > limits.STEP_JITTER_MAX / fps)] = np.nan
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
    if not (math.isfinite(length_m) and limits.HAND_LENGTH_MIN_M <= length_m <= limits.HAND_LENGTH_MAX_M):
        wanted = f"{limits.HAND_LENGTH_MIN_M:g} to {limits.HAND_LENGTH_MAX_M:g} m"
        raise InputError("length of the hand", wanted=wanted, came=f"{length_m:g} m")
    factor = length_m / hand_length(sequence.joints_m)
    return dataclasses.replace(sequence, joints_m=sequence.joints_m * factor, valid=sequence.valid)


def _wrist(joints: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Wrists (F, 3): a missing one where it lay to the knuckles before and after; where one of those is missing too
    between its neighbors, held at both ends."""
    seen = np.flatnonzero(valid[:, 0])
    if not len(seen):
        raise InputError("motion", wanted="the wrist in at least one frame", came="none")
    frames = np.arange(len(joints))
    wrist = np.stack([np.interp(frames, seen, joints[seen, 0, axis]) for axis in range(3)], axis=-1)
    has_knuckles = valid[:, _KNUCKLES].all(axis=1)
    known, lost = np.flatnonzero(has_knuckles & valid[:, 0]), np.flatnonzero(has_knuckles & ~valid[:, 0])
    if len(known) and len(lost):
        before, after, part = _neighbors(known, lost)
        share = part[:, None]
        wrist[lost] = (1 - share) * _wrist_as(joints, before, lost) + share * _wrist_as(joints, after, lost)
    return wrist


def _wrist_as(joints: np.ndarray, known: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Wrists (L, 3) in the frames `lost` that lie to the knuckles as in the frames `known` (L,)."""
    there, here = joints[known, _KNUCKLES], joints[lost, _KNUCKLES]
    middle, center = there.mean(axis=1, keepdims=True), here.mean(axis=1, keepdims=True)
    turns = alignment(there - middle, here - center)
    return center[:, 0] + np.einsum("fij,fj->fi", turns, joints[known, 0] - middle[:, 0])


def _palms(joints: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frames of the palm (F, 3, 3) at every time, turned evenly where it was not seen; and where it was (F,)."""
    palms, has_palm = palm_frames(joints)
    lost, known = np.flatnonzero(~has_palm), np.flatnonzero(has_palm)
    if len(known) and len(lost):
        before, after, part = _neighbors(known, lost)
        palms[lost] = rotations_between(palms[before], palms[after], part)
    return palms, has_palm


def _lengths(lengths: np.ndarray) -> np.ndarray:
    """(F, 20) lengths of bones with the missing ones between their neighbors; NaN for a bone that was never seen."""
    result, frames = lengths.copy(), np.arange(len(lengths))
    for bone in result.T:
        known = np.isfinite(bone)
        if known.any():
            bone[:] = np.interp(frames, frames[known], bone[known])
    return result


def _reach(joints: np.ndarray, valid: np.ndarray, lengths: np.ndarray, joint: int) -> None:
    """Turns the bone to a filled joint so far that the bones beyond it reach the next joint of its finger that was
    seen. Frames that show none are left."""
    lost = np.flatnonzero(~valid[:, joint])
    total, longest = np.zeros(len(lost)), np.zeros(len(lost))
    for end in range(joint + len(FINGERS), JOINT_COUNT, len(FINGERS)):
        bone = lengths[lost, end - 1]
        total, longest = total + bone, np.maximum(longest, bone)
        seen = valid[lost, end]
        rows, reach = lost[seen], (np.maximum(2 * longest - total, 0.0)[seen], total[seen])
        joints[rows, joint] = _turned(joints[rows, PARENTS[joint]], joints[rows, joint], joints[rows, end], reach)
        lost, total, longest = lost[~seen], total[~seen], longest[~seen]


def _turned(start: np.ndarray, joint: np.ndarray, end: np.ndarray, reach: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Joints (L, 3) turned about `start` until they are no nearer to `end` (L, 3), and no farther, than `reach`; in the
    plane in which they are. As far as the triangle lets them."""
    bone, way = joint - start, end - start
    length, distance = np.linalg.norm(bone, axis=-1), np.linalg.norm(way, axis=-1)
    rest = np.clip(np.linalg.norm(end - joint, axis=-1), *reach)
    rest = np.clip(rest, np.abs(distance - length), distance + length)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = way / distance[:, None]
        part = (length**2 + distance**2 - rest**2) / (2 * distance)
        aside = bone - (bone * along).sum(-1, keepdims=True) * along
        aside *= (np.sqrt(np.maximum(length**2 - part**2, 0.0)) / np.linalg.norm(aside, axis=-1))[:, None]
    turned = start + part[:, None] * along + aside
    # a bone of no direction aside, or of unknown length beyond, stays
    return np.where(np.isfinite(turned), turned, joint)


def _vectors_at(known: np.ndarray, vectors: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Vectors (K, 3) seen in the frames `known` -> (W, 3) in the frames `wanted`: great circles, linear lengths."""
    before, after, part = _neighbors(np.arange(len(known)), np.interp(wanted, known, np.arange(len(known))))
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    directions = vectors / np.where(length > 0, length, 1.0)
    a, b = (torch.from_numpy(directions[rows].T.copy()) for rows in (before, after))
    turned = slerp(a, b, torch.from_numpy(part)).numpy().T
    return turned * ((1 - part[:, None]) * length[before] + part[:, None] * length[after])


def _neighbors(known: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of `wanted` the one of the rising `known` before and after it, and which part of the way it is."""
    place = np.clip(np.searchsorted(known, wanted), 0, len(known) - 1)
    before = known[np.where((known[place] > wanted) & (place > 0), place - 1, place)]
    after = known[place]
    way = np.where(after > before, after - before, 1)
    return before, after, np.clip((wanted - before) / way, 0.0, 1.0)


def _never_seen(sequence: PoseSequence, name: str) -> InputError:
    return InputError(
        "motion",
        wanted="every bone in at least one frame",
        came=f"none that shows the bone to {name}",
        remedy=f"In {len(sequence.gaps.frames)} of {len(sequence)} frames joints are missing.",
    )
