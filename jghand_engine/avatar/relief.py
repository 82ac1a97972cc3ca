"""The relief of skin that is finer than its surface: heights in the texture's square, and how bent joints change them.

A pixel of detail gets the light that skin of the relief's slope gets there (native/detail.cpp). Wrinkles of straight
joints go as they bend, folds deepen: two heights, mixed by how bent the joint near a place is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.detail_mips import averaged_levels, in_squares, with_rings
from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.rotations import unit

# of a stored height: the finest that shading shows, where 127 of them are half a millimeter
HEIGHT_STEP_M = 4e-6
# a rise is the sum of differences of heights so many texels to both sides, times these: of fourth order, as neighbors
# alone make a wave of four texels a third flatter
RISES = {1: 2 / 3, 2: -1 / 12}
# by which part of itself light on a pixel changes at most (native/detail.cpp)
LIGHT_CHANGE_MAX = 1.5
# largest step of a slope, a byte
SLOPE_STEPS = 127
# the joints that bend skin, level order: all that have a bone on both sides
BENDING = np.arange(1, 16)
# bend over which the skin of a joint goes from straight to bent, degrees
BEND_DEG = (8.0, 70.0)
# the thumb's first two joints are bent in the canonical hand: so much of it is none, degrees
THUMB_JOINTS, THUMB_REST_DEG = (1, 6), 25.0
# how far a joint bends the skin of its finger, m; a first joint that of the hand as well, over this and this strongly
REACH_M, REACH_ON_HAND_M, ON_HAND = 0.007, 0.009, 0.35
# what skin far from all joints counts as, against weights of 1 at a joint: straight
STRAIGHT = 0.02


@dataclass(frozen=True)
class Relief:
    """height: (S, S, 2) int8, in steps of HEIGHT_STEP_M above the surface, where joints are straight and where they are
    bent; the square is that of the texture."""

    height: np.ndarray

    def rises_m(self, skin: np.ndarray, *, bent: bool = False) -> np.ndarray:
        """(S, S, 2) how the heights rise along column and row, meters per side of the square; 0 where there is no skin.
        skin: (S, S) bool, see `skin_texels`"""
        height = self.height[..., int(bent)]
        height_m = np.where(skin, height * np.float32(HEIGHT_STEP_M), np.float32(0))[..., None]
        # at its edge skin goes on as high
        with_rings(height_m, skin)
        padded, size = np.pad(height_m[..., 0], 2, mode="edge"), len(height)
        rise_m = np.zeros((size, size, 2), np.float32)
        for apart, share in RISES.items():
            before, after = slice(2 - apart, 2 - apart + size), slice(2 + apart, 2 + apart + size)
            rise_m[..., 0] += np.float32(share * size) * (padded[2:-2, after] - padded[2:-2, before])
            rise_m[..., 1] += np.float32(share * size) * (padded[after, 2:-2] - padded[before, 2:-2])
        rise_m[~skin] = 0
        return rise_m

    def slopes(self, skin: np.ndarray) -> Slopes:
        """What is drawn of it."""
        rises_m = [self.rises_m(skin, bent=bent) for bent in (False, True)]
        step_m = max(*(max(float(rise.max()), -float(rise.min())) for rise in rises_m), 1e-9) / SLOPE_STEPS
        every, most = [], []
        while rises_m:
            rise = rises_m.pop(0)
            rise /= np.float32(step_m)
            levels, of_levels = [], []
            for mean in averaged_levels(rise, skin):
                of_levels.append(max(float(mean.max()), -float(mean.min())))
                levels.append(in_squares(np.rint(mean, out=mean).astype(np.int8)))
            every.append(np.concatenate(levels))
            most.append(of_levels)
        return Slopes(np.concatenate(every, 1).view(np.uint32).ravel(), step_m, np.max(most, 0))


@dataclass(frozen=True)
class Slopes:
    """What is drawn of a relief.

    texels: uint32, all levels as those of `Mips`; four signed bytes: rise along column and row where joints are
            straight, then where they are bent
    step_m: rise per side of the square, meters, of a step
    most:   (levels,) the largest number of steps
    """

    texels: np.ndarray
    step_m: float
    most: np.ndarray


def bends_deg(joints_m: np.ndarray) -> np.ndarray:
    """(P, 21, 3) level order -> (P, 15) angles between the two bones at BENDING."""
    before = unit(joints_m[:, BENDING] - joints_m[:, np.array(PARENTS)[BENDING]])
    after = unit(joints_m[:, BENDING + 5] - joints_m[:, BENDING])
    return np.degrees(np.arccos(np.clip((before * after).sum(-1), -1, 1)))


def finger_shares(bone_weights: np.ndarray) -> np.ndarray:
    """(V, 5) what of (V, 21) weights is each finger's: of three bones behind its knuckle, level order."""
    return bone_weights[:, 6:].reshape(-1, 3, 5).sum(1)


class Bend:
    """How bent the skin near each of V places is: the sum of what its joints are, times `near` (V, 15).

    rest_m: (V, 3) of the hand at rest, meters · finger_share: (V, 5) what of a place's bones is each finger's ·
    joints_m: (21, 3) at rest, level order · rest_deg: (15,) angles that count as straight
    """

    def __init__(self, rest_m: np.ndarray, finger_share: np.ndarray, joints_m: np.ndarray) -> None:
        distance_m = np.linalg.norm(rest_m[:, None] - joints_m[BENDING], axis=-1)
        share = np.tile(finger_share, 3)
        on_hand = ON_HAND * np.exp(-0.5 * np.square(distance_m[:, :5] / REACH_ON_HAND_M))
        share[:, :5] = np.maximum(share[:, :5], on_hand)
        near = np.exp(-0.5 * np.square(distance_m / REACH_M)) * share
        self.near = near / (near.sum(1, keepdims=True) + STRAIGHT)
        self.rest_deg = np.zeros(len(BENDING))
        thumb = np.isin(BENDING, THUMB_JOINTS)
        self.rest_deg[thumb] = np.minimum(bends_deg(joints_m[None])[0, thumb], THUMB_REST_DEG)

    def of_joints(self, joints_m: np.ndarray) -> np.ndarray:
        """Posed joints (P, 21, 3), level order -> (P, 15) 0..1, of BENDING."""
        low, high = BEND_DEG
        part = ((bends_deg(joints_m) - self.rest_deg - low) / (high - low)).clip(0, 1)
        return part * part * (3 - 2 * part)
