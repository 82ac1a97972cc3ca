"""Which bone each Gaussian of a hand belongs to: for maps that say what a pixel shows."""

from __future__ import annotations

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.orders import STANDARD_OF_LEVEL

# level order: the bones from the wrist to the knuckles
_PALM = slice(1, 6)


def bone_numbers(avatar: HandAvatar) -> np.ndarray:
    """(N,) uint8, 1..20: the bone that moves a Gaussian most, by the number of the joint at which it ends, in the
    standard order.

    What moves with the palm as a whole (B_0, METHOD 2.6) belongs to the nearest of the five bones of the palm.
    """
    weights = avatar.bone_weights
    bone = weights.argmax(1)
    palm = bone == 0
    bone[palm] = 1 + _palm_distances(avatar, palm).argmin(1)
    return STANDARD_OF_LEVEL[bone].astype(np.uint8)


def _palm_distances(avatar: HandAvatar, rows: np.ndarray) -> np.ndarray:
    """(M, 5) squared distances of the canonical centers of these rows from the bones of the palm."""
    points = avatar.position_m[rows].astype(np.float64)[:, None]
    joints = avatar.canonical_joints_m
    start, end = joints[list(PARENTS[_PALM])], joints[_PALM]
    along = ((points - start) * (end - start)).sum(-1) / np.square(end - start).sum(-1)
    nearest = start + along.clip(0, 1)[..., None] * (end - start)
    return np.square(points - nearest).sum(-1)
