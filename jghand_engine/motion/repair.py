"""Gaps of a motion filled from the frames before and after. Knows no files.

Everything here turns bones and keeps their lengths: interpolating positions would shorten fingers on the way.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, JOINT_COUNT, LEVEL_NAMES, PARENTS
from jghand_engine.hand.rotations import alignment, slerp, slerp_rotation
from jghand_engine.hand.sequence import GapReport, PoseSequence, palm_frames

# a gap longer than this is told: seconds
GAP_LONG_S = 0.5
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
            "was seen after."
        )
        if longest_s > GAP_LONG_S:
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
            raise InputError(
                "motion",
                wanted="every bone in at least one frame",
                came=f"none that shows the bone to {LEVEL_NAMES[joint]}",
                remedy=f"In {len(sequence.gaps.frames)} of {len(sequence)} frames joints are missing.",
            )
        bones = sequence.joints_m[known, joint] - sequence.joints_m[known, parent]
        inside = np.einsum("fji,fj->fi", palms[known], bones)
        joints[lost, joint] = joints[lost, parent] + np.einsum(
            "fij,fj->fi", palms[lost], _vectors_at(known, inside, lost)
        )
        _reach(joints, valid, lengths, joint)
    filled = sequence.filled | ~valid.all(axis=1)
    whole = dataclasses.replace(sequence, joints_m=joints, valid=np.ones_like(valid), filled=filled)
    return FilledMotion(whole, sequence.gaps)


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
        palms[lost] = slerp_rotation(palms[before], palms[after], part)
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
    nearest, farthest = np.abs(distance - length), distance + length
    bends = (nearest < rest) & (rest < farthest)
    rest = np.clip(rest, nearest, farthest)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = way / distance[:, None]
        part = (length**2 + distance**2 - rest**2) / (2 * distance)
        aside = bone - (bone * along).sum(-1, keepdims=True) * along
        height = np.where(bends, np.sqrt(np.maximum(length**2 - part**2, 0.0)), 0.0)
        aside *= (height / np.linalg.norm(aside, axis=-1))[:, None]
    turned = start + part[:, None] * along + aside
    # a bone of no direction aside, or of unknown length beyond, stays
    return np.where(np.isfinite(turned), turned, joint)


def _vectors_at(known: np.ndarray, vectors: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Vectors (K, 3) seen in the frames `known` -> (W, 3) in the frames `wanted`: great circles, linear lengths."""
    before, after, part = _neighbors(np.arange(len(known)), np.interp(wanted, known, np.arange(len(known))))
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    directions = vectors / np.where(length > 0, length, 1.0)
    turned = slerp(directions[before], directions[after], part)
    return turned * ((1 - part[:, None]) * length[before] + part[:, None] * length[after])


def _neighbors(known: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each of `wanted` the one of the rising `known` before and after it, and which part of the way it is."""
    place = np.clip(np.searchsorted(known, wanted), 0, len(known) - 1)
    before = known[np.where((known[place] > wanted) & (place > 0), place - 1, place)]
    after = known[place]
    way = np.where(after > before, after - before, 1)
    return before, after, np.clip((wanted - before) / way, 0.0, 1.0)
