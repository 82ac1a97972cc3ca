"""A hand posed by the angles of its joints, as anatomy counts them, within the ranges of human joints.

Angles are per finger, in degrees, because that is how tables of ranges read. Fingers: MCP flexion, MCP abduction
(positive away from the middle finger), PIP flexion, DIP flexion; flexion 0 is a straight finger, abduction 0 the spread
of the canonical hand. Thumb: CMC flexion (sweeps across the palm), CMC abduction, MCP and IP flexion; 0 is the thumb of
the canonical hand. So the same angles fit any canonical hand. DATA 8, METHOD 4.1.
"""

from __future__ import annotations

from enum import StrEnum

import numpy as np

from jghand_engine.hand.rotations import axis_rotation
from jghand_engine.hand.skeleton import CanonicalHand, euler_swing

# lowest and highest angle, degrees; (5 fingers, 4 angles, 2)
RANGES_DEG = np.array(
    [[(-15, 45), (-15, 35), (-10, 55), (-15, 85)]] + [[(-25, 92), (-22, 25), (-5, 112), (-8, 82)]] * 4, dtype=np.float64
)
# ranges of the angles in the frames of the skeleton, degrees: flexion and abduction of bones 6..20 (METHOD 4.1);
# used to normalize features
FRAME_RANGES_DEG = np.array(
    [
        [(-20, 130), (-80, 80)] if finger == 0 else [flexion, (-abduction, abduction)]
        for flexion, abduction in (((-30, 100), 35), ((-10, 115), 15), ((-20, 90), 15))
        for finger in range(5)
    ],
    dtype=np.float64,
)
# +abduction turns index and middle to the thumb's side, ring and pinky to the other
ABDUCTION_SIDE = np.array([1.0, 1.0, 1.0, -1.0, -1.0])
# out of the palm for the thumb, in the palm frame (out of the palm, towards the thumb, distal); DATA 8
_THUMB_NORMAL = np.array([0.59, -0.80, -0.10])

# tips touch: air of this part of the finger chain's length (about 3 mm) weighs as much as turning one joint by the
# pull; a weaker pull bends fingers oddly to close the last tenth of a millimeter
TOUCH_PART = 0.02
TOUCH_PULL_DEG = 40.0
# half a finger's thickness and half the thumb's, as part of that length: the tip's joint stays so far from the bone
TOUCH_THICKNESS_PART = 0.07
# Gauss-Newton steps and the step of its differences; four steps reach the end on the built-in hand
TOUCH_STEPS = 8
TOUCH_DIFFERENCE_DEG = 1e-3


class Contact(StrEnum):
    """Where the thumb's tip meets a finger: at its tip, or resting on the back of its middle phalanx."""

    TIP = "tip"
    REST = "rest"


class ArticulatedHand:
    """A canonical hand that can be posed by anatomical angles; bones keep the canonical lengths exactly.

    canonical_joints_m: (21, 3) right hand, level order, meters
    straight_joints_m:  (21, 3) the hand whose fingers are straight: what `turns` turns
    flexion_axes, abduction_axes: (3, 5, 3) of the three moving bones of each finger in the straight hand
    finger_length_m:    of the middle finger with its metacarpal
    """

    def __init__(self, canonical_joints_m: np.ndarray) -> None:
        hand = CanonicalHand.build(canonical_joints_m)
        self.straight_joints_m = joints = hand.joints_m + hand.root_m
        self.finger_length_m = float(hand.length_m[[2, 7, 12, 17]].sum())
        frame = hand.frames[1:6]
        for first in (0, 5, 10):
            # straight fingers keep their spread and their natural sideways bends; the thumb stays as it is
            u = hand.u[first : first + 5].copy()
            u[1:, 2], u[1:, 0] = np.hypot(u[1:, 0], u[1:, 2]), 0.0
            bones = hand.length_m[first + 5 : first + 10, None] * np.einsum("fij,fj->fi", frame, u)
            joints[first + 6 : first + 11] = joints[first + 1 : first + 6] + bones
            frame = frame @ euler_swing(u)
        self._bones = (joints[6:] - joints[1:16]).reshape(3, 5, 3)
        direction = self._bones / np.linalg.norm(self._bones, axis=-1, keepdims=True)
        palm = hand.frames[0]
        normal = np.stack([palm @ _THUMB_NORMAL, *[palm[:, 0]] * 4])
        normal = normal - (normal * direction).sum(-1, keepdims=True) * direction
        self.abduction_axes = normal / np.linalg.norm(normal, axis=-1, keepdims=True)
        self.flexion_axes = np.cross(direction, self.abduction_axes)

    def joints(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) angles, degrees, clamped to RANGES_DEG -> (F, 21, 3) joints, meters."""
        bones = np.einsum("nkfij,kfj->nkfi", self.turns(angles_deg), self._bones)
        joints = np.tile(self.straight_joints_m, (len(bones), 1, 1))
        for level in range(3):
            first = 1 + 5 * level
            joints[:, first + 5 : first + 10] = joints[:, first : first + 5] + bones[:, level]
        return joints

    def turns(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) angles, degrees, clamped to RANGES_DEG -> (F, 3, 5, 3, 3) rotations of the three moving bones of
        each finger, from where they point in the straight hand."""
        angle = np.radians(np.clip(np.asarray(angles_deg, dtype=np.float64), RANGES_DEG[..., 0], RANGES_DEG[..., 1]))
        turn = axis_rotation(self.abduction_axes[0], -ABDUCTION_SIDE * angle[..., 1])
        turns = []
        for joint, which in enumerate((0, 2, 3)):
            turn = turn @ axis_rotation(self.flexion_axes[joint], angle[..., which])
            turns.append(turn)
        return np.stack(turns, axis=1)

    def touching(self, angles: np.ndarray, contact: Contact, finger: int) -> np.ndarray:
        """The nearest angles (5, 4), degrees, at which the thumb's tip touches `finger` (1 index .. 4 pinky).

        Gauss-Newton on the distance, with a pull to the given angles and the ranges as bounds. A hand that cannot reach
        stays as near as it gets."""
        moving = [(0, k) for k in range(4)]
        if contact is Contact.TIP:
            moving += [(finger, k) for k in range(4)]
        rows, cols = np.array(moving).T
        start = angles[rows, cols]
        low, high = RANGES_DEG[rows, cols].T
        pull = np.eye(len(start)) / TOUCH_PULL_DEG
        value = np.clip(start, low, high)
        for _ in range(TOUCH_STEPS):
            # the gap at the value and, for the Jacobian, beside it in each angle: inwards, as joints stop at the range
            beside = np.where(value < (low + high) / 2, TOUCH_DIFFERENCE_DEG, -TOUCH_DIFFERENCE_DEG)
            trials = np.repeat(angles[None], len(start) + 1, axis=0)
            trials[:, rows, cols] = value
            trials[np.arange(1, len(start) + 1), rows, cols] += beside
            gap = self._gap(self.joints(trials), contact, finger) / (TOUCH_PART * self.finger_length_m)
            jacobian = (gap[1:] - gap[0]).T / beside
            residual = np.concatenate([gap[0], (value - start) / TOUCH_PULL_DEG])
            step = bounded_least_squares(np.concatenate([jacobian, pull]), -residual, low - value, high - value)
            value = np.clip(value + step, low, high)  # the bounds hold but for rounding
        solved = angles.copy()
        solved[rows, cols] = value
        return solved

    def _gap(self, joints: np.ndarray, contact: Contact, finger: int) -> np.ndarray:
        """(F, 21, 3) joints -> (F, 3) from the thumb's tip to the place that it should touch, meters."""
        tip = joints[:, 16]
        if contact is Contact.TIP:
            return joints[:, 16 + finger] - tip
        knuckle, start, end = (joints[:, first + finger] for first in (1, 6, 11))
        phalanx = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
        # of a bent finger the first phalanx points away from the back of the second
        back = start - knuckle
        back = back - (back * phalanx).sum(axis=1, keepdims=True) * phalanx
        back = back / np.linalg.norm(back, axis=1, keepdims=True)
        return (start + end) / 2 + TOUCH_THICKNESS_PART * self.finger_length_m * back - tip


def bounded_least_squares(matrix: np.ndarray, target: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """The x (n,) from `low` to `high` with the least |matrix x - target|, by active sets (Stark and Parker 1995).

    matrix: (m, n) of full rank, n small · low, high: (n,) on either side of 0
    """
    x, free = np.zeros(len(low)), np.ones(len(low), dtype=bool)
    noise = 1e-12 * np.abs(matrix.T @ target).max(initial=0.0)
    while True:
        # the best of the free ones; those that would leave their bounds stop there, and one after the other is bound
        while free.any():
            best = np.linalg.lstsq(matrix[:, free], target - matrix[:, ~free] @ x[~free], rcond=None)[0]
            here, bound = x[free], np.where(best > x[free], high[free], low[free])
            leaves = (best < low[free]) | (best > high[free])
            if not leaves.any():
                x[free] = best
                break
            parts = np.where(leaves, (bound - here) / np.where(leaves, best - here, 1.0), np.inf)
            stops = parts <= parts.min()
            x[free] = np.where(stops, bound, here + parts.min() * (best - here))
            free[np.flatnonzero(free)[stops]] = False
        slope = matrix.T @ (target - matrix @ x)
        inwards = np.where(x <= low, slope, -slope)
        inwards[free] = 0.0
        if inwards.max(initial=0.0) <= noise:
            return x
        free[inwards.argmax()] = True
