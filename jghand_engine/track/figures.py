"""How far off, how jittery and how late a motion is. Directions of bones are compared: they have no scale."""

from __future__ import annotations

import numpy as np

from jghand_engine.hand.rotations import alignment
from jghand_engine.hand.sequence import bone_directions

# how far a lag is looked for, seconds, and in which steps
LAG_MAX_S = 0.25
LAG_STEP_S = 0.001

# of the 20 bones those of the palm come first
FINGER_BONES = slice(5, 20)


def angles_between_deg(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(..., 3) and (..., 3) unit -> (...) degrees."""
    # as exact for small angles as for large ones, which an arc cosine is not
    return np.degrees(2 * np.arctan2(np.linalg.norm(first - second, axis=-1), np.linalg.norm(first + second, axis=-1)))


def directions_in_palm(joints_m: np.ndarray, canonical_joints_m: np.ndarray) -> np.ndarray:
    """(F, 21, 3) level-order joints -> (F, 20, 3) directions of the bones, the palm turned onto a canonical one."""
    directions = bone_directions(joints_m)
    palm = bone_directions(canonical_joints_m[None])[:, :5]
    turn = alignment(directions[:, :5], np.broadcast_to(palm, (len(directions), 5, 3)))
    return directions @ np.swapaxes(turn, -1, -2)


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


def lag_ms(tracked: np.ndarray, truth: np.ndarray, fps: float) -> float:
    """How much later than the truth a motion is, milliseconds: the shift in time at which finger bones differ least.

    Both (F, 20, 3) directions in the palm. NaN for motions too short to shift.
    """
    count = len(truth)
    reach = min(LAG_MAX_S, (count - 3) / (2 * fps))
    if reach <= 0:
        return float("nan")
    time = np.arange(count) / fps
    inner = (time >= reach) & (time <= time[-1] - reach)
    wanted = truth[inner][:, FINGER_BONES]
    shifts = np.arange(-reach, reach, LAG_STEP_S)
    costs = []
    for shift in shifts:
        at = (time[inner] + shift) * fps
        before = np.clip(np.floor(at).astype(int), 0, count - 2)
        part = (at - before)[:, None, None]
        there = (1 - part) * tracked[before][:, FINGER_BONES] + part * tracked[before + 1][:, FINGER_BONES]
        costs.append(np.square(there - wanted).sum(-1).mean())
    return float(1000 * shifts[int(np.argmin(costs))])
