"""The fist of a hand by its skin: fingers turned until they touch the neighbors on which they lean and bent until their
tips press the palm, and a thumb that is not in them. It is found once, where an avatar is made; its file keeps it.
SKIN, Poses closed by skin.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.captures.making.skin_gaps import HandSkin, SkinGaps
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import (
    FIST_ROOM_RANGE_PARTS,
    FIST_TURN_RANGE_DEG,
    ArchingHand,
    Fist,
    bounded_least_squares,
)
from jghand_engine.hand.poses import named_pose
from jghand_engine.render.detail import DetailedHand

# how deep skin is in other skin, mm, of fingers side by side, of tips in the palm, and of the thumb at most: they touch
# in every pose that follows, exactly or by an armature of other directions
SIDE_MM, TIP_MM, THUMB_MM = -0.25, -1.2, -0.5
# of middle, ring and pinky. The index finger's tip meets the ball of the thumb, which it moves: it is left to the bones
ON_PALM = (2, 3, 4)
# Gauss-Newton steps, how far back its differences look, and what a change weighs, mm for a degree or for all of the
# length: skin that hardly comes nearer is not worth a crooked finger
STEPS, BACK_DEG, BACK_PARTS, DEGREE_MM, LENGTH_MM = 5, 1.0, 0.005, 0.02, 5.0
# the thumb lies on the fingers afterwards: how often it is lifted by what is missing
THUMB_STEPS = 4


def with_fist(avatar: HandAvatar) -> HandAvatar:
    """The avatar with the fist that the surface of its detail wants; one without a detail has that of other hands."""
    if avatar.detail is None:
        return avatar
    return replace(avatar, fist=fist_by_skin(avatar.rest_joints_m, gaps_of(avatar)))


def gaps_of(avatar: HandAvatar) -> Callable[[np.ndarray], SkinGaps]:
    """Of the surface of an avatar's detail, for joints (21, 3) of a right hand. InputError for one without."""
    right = avatar.for_hand(Handedness.RIGHT)
    hand, skeleton = DetailedHand.of(right, 1.0), right.skeleton()
    bones = hand.detail.bone_weights[:, 6:].reshape(-1, 3, 5)
    skin = HandSkin(hand.detail.faces, bones[:, 0], bones[:, 1:].sum(1))
    return lambda joints_m: skin.gaps(hand.posed_m(skeleton.bones(joints_m)))


def fist_by_skin(rest_joints_m: np.ndarray, gaps: Callable[[np.ndarray], SkinGaps]) -> Fist:
    """Of the right hand with these joints (21, 3) at rest. gaps: of its skin, of joints (21, 3)"""

    def skin(fist: Fist) -> SkinGaps:
        return gaps(named_pose("fist", rest_joints_m, handedness=Handedness.RIGHT, fist=fist))

    def missing(changes: np.ndarray) -> np.ndarray:
        there = skin(_fist(changes))
        return np.concatenate([there.neighbors() - SIDE_MM, there.palm(ON_PALM) - TIP_MM, weights_mm * changes])

    weights_mm, back = np.repeat([DEGREE_MM, LENGTH_MM], 3), np.repeat([BACK_DEG, BACK_PARTS], 3)
    low, high = np.repeat([FIST_TURN_RANGE_DEG, FIST_ROOM_RANGE_PARTS], 3, axis=0).T
    changes = np.zeros(6)
    for _ in range(STEPS):
        here = missing(changes)
        slopes = np.stack([here - missing(changes - way) for way in np.diag(back)], 1) / back
        changes += bounded_least_squares(slopes, -here, low - changes, high - changes)
    fist, length_mm = _fist(changes.round(4)), 1e3 * ArchingHand(rest_joints_m).finger_length_m
    for _ in range(THUMB_STEPS):
        lifted = fist.thumb_part + (THUMB_MM - skin(fist).thumb((1, 2)).min()) / length_mm
        fist = replace(fist, thumb_part=round(float(np.clip(lifted, 0.0, FIST_ROOM_RANGE_PARTS[1])), 4))
    return fist


def _fist(changes: np.ndarray) -> Fist:
    return Fist(tuple(changes[:3].tolist()), tuple(changes[3:].tolist()))
