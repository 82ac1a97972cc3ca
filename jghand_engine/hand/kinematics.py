"""A hand posed by the angles of its joints, as anatomy counts them, within the ranges of human joints.

Angles are per finger, in degrees, because that is how tables of ranges read. Fingers: MCP flexion, MCP abduction
(positive away from the middle finger), PIP flexion, DIP flexion; flexion 0 is a straight finger, abduction 0 the spread
of the canonical hand. Thumb: CMC flexion (sweeps across the palm), CMC abduction, MCP and IP flexion; 0 is the thumb of
the canonical hand. So the same angles fit any canonical hand. DATA 8, METHOD 4.1.

What touches is found by bones, each as thick as it is on the hands that captures show: their skin then touches to
within 2 mm (scripts/show_skin_gaps.py).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from .canonical import CanonicalHand, euler_swing
from .rotations import axis_rotation, unit

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

# finger and the neighbor on which it leans, thumb 0 .. pinky 4
NEIGHBORS = ((1, 2), (3, 2), (4, 3))

# tips touch: air of this part of the finger chain's length (about 3 mm) weighs as much as turning one joint by the
# pull; a weaker pull bends fingers oddly to close the last tenth of a millimeter
TOUCH_PART = 0.02
TOUCH_PULL_DEG = 40.0
# between the bones of what touches, as parts of that length: from the joint of one tip to the other's, of the thumb's
# last bone from those of the finger that it rests on, and of its last two from those of the fingers before
TIP_THICKNESS_PART, REST_PART, BESIDE_PARTS = 0.041, 0.076, (0.072, 0.088)
# Gauss-Newton steps, how far they go at most (a long one leads a thumb past the finger), and that of its differences
TOUCH_STEPS, TOUCH_STEP_DEG = 12, 8.0
TOUCH_DIFFERENCE_DEG = 1e-3
# of the last two bones of index to pinky from the metacarpals, where the skin of their tips presses the palm by a
# millimeter or two
PALM_GAP_PARTS = (0.058, 0.071, 0.084, 0.073)
# flexions are scaled down to this for it, at most, in so many steps
EASE_MOST, EASE_STEPS = 0.7, 31
# rounds of alternating projection for the gap between two bones
GAP_ROUNDS = 8

# the palm arches when fingers close: turns of the metacarpals of index to pinky about the wrist, degrees, in the palm's
# plane (towards the thumb's side below 0) and out of it, and the flexion of the knuckle at which it begins and ends.
# Those of the captures' rig (SKIN, Poses closed by skin), whose metacarpals turn about their bases
ARCH_DEG, SINK_DEG = (1.7, 0.0, -1.3, -4.6), (0.3, 0.0, 2.7, 5.5)
ARCH_FLEXIONS_DEG = (45.0, 90.0)


class Contact(StrEnum):
    """Where the thumb's tip meets a finger: at its tip, or resting on its back."""

    TIP = "tip"
    REST = "rest"


@dataclass(frozen=True)
class Fist:
    """What the skin of a hand changes in its fist: bones do not say how thick fingers are.

    turns_deg:  more abduction of index, ring and pinky, so that they touch the neighbors on which they lean
    room_parts: more room between the metacarpals and middle, ring and pinky, as `PALM_GAP_PARTS`
    thumb_part: and between thumb and fingers, as `REST_PART` and `BESIDE_PARTS`
    """

    turns_deg: tuple[float, ...] = (0.0, 0.0, 0.0)
    room_parts: tuple[float, ...] = (0.0, 0.0, 0.0)
    thumb_part: float = 0.0


# that of the table of poses, for a hand whose skin is not known
NO_FIST = Fist()
# the least and the largest changes: hands want -8 to 6 degrees and a hundredth of the length. 9 degrees more than the
# table has, with those of the ring finger, end the pinky's range
FIST_TURN_RANGE_DEG, FIST_ROOM_RANGE_PARTS = (-9.0, 6.0), (-0.02, 0.02)


class ArticulatedHand:
    """A canonical hand that can be posed by anatomical angles; bones keep the canonical lengths exactly, and knuckles
    their places.

    canonical_joints_m: (21, 3) right hand, level order, meters
    fist:               what its skin wants, if that is known
    straight_joints_m:  (21, 3) the hand whose fingers are straight: what `turns` turns
    flexion_axes, abduction_axes: (3, 5, 3) of the three moving bones of each finger in the straight hand
    palm_normal:        (3,) unit, out of the palm
    finger_length_m:    of the middle finger with its metacarpal
    """

    def __init__(self, canonical_joints_m: np.ndarray, fist: Fist = NO_FIST) -> None:
        hand = CanonicalHand.build(canonical_joints_m)
        self.fist = fist
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
        self.palm_normal = palm[:, 0]
        normal = np.stack([palm @ _THUMB_NORMAL, *[self.palm_normal] * 4])
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

    def eased(self, angles_deg: np.ndarray) -> np.ndarray:
        """(5, 4) angles whose bent fingers are opened until their last bones lie on the palm, not in it.

        Each finger's three flexions are scaled by one factor, the largest that leaves room.
        """
        factors = np.linspace(1.0, EASE_MOST, EASE_STEPS)
        trials = np.repeat(angles_deg[None], len(factors), axis=0)
        flexions = np.ix_(range(len(factors)), range(1, 5), (0, 2, 3))
        trials[flexions] = trials[flexions] * factors[:, None, None]
        room_parts = np.add(PALM_GAP_PARTS, (0.0, *self.fist.room_parts))
        gaps = palm_gaps_m(self.joints(trials)) - self.finger_length_m * room_parts
        eased = angles_deg.copy()
        for finger, gap in enumerate(gaps.T, start=1):
            # where no factor is enough the last one is the best there is
            free = int((gap >= 0).argmax()) if gap.max() >= 0 else len(factors) - 1
            around = slice(max(free - 1, 0), free + 1)
            factor = np.interp(0.0, gap[around], factors[around])
            eased[finger, [0, 2, 3]] *= factor
        return eased

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
        value = best = np.clip(start, low, high)
        residual, jacobian = np.zeros(len(start)), pull
        least, reach = np.inf, TOUCH_STEP_DEG
        for _ in range(TOUCH_STEPS):
            # the gap at the value and, for the Jacobian, beside it in each angle: inwards, as joints stop at the range
            beside = np.where(value < (low + high) / 2, TOUCH_DIFFERENCE_DEG, -TOUCH_DIFFERENCE_DEG)
            trials = np.repeat(angles[None], len(start) + 1, axis=0)
            trials[:, rows, cols] = value
            trials[np.arange(1, len(start) + 1), rows, cols] += beside
            gap = self._gap(self.joints(trials), contact, finger) / (TOUCH_PART * self.finger_length_m)
            trial = np.concatenate([gap[0], (value - start) / TOUCH_PULL_DEG])
            if trial @ trial < least:
                best, least, residual = value, trial @ trial, trial
                jacobian = np.concatenate([(gap[1:] - gap[0]).T / beside, pull])
            else:
                # the nearest bone of the finger has changed on the way
                reach /= 2
            lower, upper = np.maximum(low - best, -reach), np.minimum(high - best, reach)
            step = bounded_least_squares(jacobian, -residual, lower, upper)
            value = np.clip(best + step, low, high)  # the bounds hold but for rounding
        solved = angles.copy()
        solved[rows, cols] = best
        return solved

    def _gap(self, joints: np.ndarray, contact: Contact, finger: int) -> np.ndarray:
        """(F, 21, 3) joints -> (F, n) what is missing to the contact, meters: from the thumb's tip to the place that it
        should touch; or how far it is from the finger, and how deep its last two bones are in the fingers before."""
        size_m = self.finger_length_m
        if contact is Contact.TIP:
            middle, end, fingertip = (joints[:, first + finger] for first in (6, 11, 16))
            along = unit(fingertip - end)
            # the bone before a bent one points out of its back
            back = end - middle - ((end - middle) * along).sum(axis=1, keepdims=True) * along
            return fingertip - TIP_THICKNESS_PART * size_m * unit(back) - joints[:, 16]
        thumb, of_finger = np.array([6, 11])[:, None], np.array([6, 11])
        bones = np.arange(1, finger + 1)[:, None, None] + of_finger
        ways = segment_way(
            joints[:, thumb][:, None], joints[:, thumb + 5][:, None], joints[:, bones], joints[:, bones + 5]
        )
        gaps = np.linalg.norm(ways, axis=-1)
        beside_m = size_m * (np.array(BESIDE_PARTS) + self.fist.thumb_part)
        deep = (beside_m - gaps[:, :-1].min(-1)).clip(0).reshape(len(joints), -1)
        # of the thumb's last bone to the nearer one
        to_it = np.where(gaps[:, -1, 1, :1] < gaps[:, -1, 1, 1:], ways[:, -1, 1, 0], ways[:, -1, 1, 1])
        return np.concatenate([to_it - (REST_PART + self.fist.thumb_part) * size_m * unit(to_it), deep], axis=1)


class ArchingHand(ArticulatedHand):
    """The same whose palm arches as fingers close: knuckles draw together, and those of ring and pinky sink."""

    def joints(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) angles, degrees, clamped to RANGES_DEG -> (F, 21, 3) joints, meters."""
        start, end = ARCH_FLEXIONS_DEG
        bent = ((np.asarray(angles_deg, dtype=np.float64)[:, 1:, 0] - start) / (end - start)).clip(0, 1)
        bent = bent**2 * (3 - 2 * bent)
        wrist = self.straight_joints_m[0]
        metacarpals = self.straight_joints_m[2:6] - wrist
        out_of_palm = np.broadcast_to(self.palm_normal, metacarpals.shape)
        sink = axis_rotation(unit(np.cross(metacarpals, out_of_palm)), np.radians(SINK_DEG) * bent)
        palm = axis_rotation(out_of_palm, np.radians(ARCH_DEG) * bent) @ sink
        joints = super().joints(angles_deg)
        for finger in range(1, 5):
            chain = np.arange(1, 17, 5) + finger
            joints[:, chain] = wrist + (joints[:, chain] - wrist) @ np.swapaxes(palm[:, finger - 1], -1, -2)
        return joints


def palm_gaps_m(joints_m: np.ndarray) -> np.ndarray:
    """(F, 21, 3) level order -> (F, 4) smallest distance of the last two bones of index..pinky from the metacarpals."""
    palm_start, palm_end = np.repeat(joints_m[:, :1], 4, axis=1), joints_m[:, 2:6]
    gaps = []
    for finger in range(1, 5):
        bones = [
            segment_gap(joints_m[:, [start + finger] * 4], joints_m[:, [start + 5 + finger] * 4], palm_start, palm_end)
            for start in (6, 11)
        ]
        gaps.append(np.min(bones, axis=(0, 2)))
    return np.stack(gaps, axis=1)


def segment_gap(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> np.ndarray:
    """Smallest distance (...) between the segments a0 a1 and b0 b1, each (..., 3)."""
    return np.linalg.norm(segment_way(a0, a1, b0, b1), axis=-1)


def segment_way(a0: np.ndarray, a1: np.ndarray, b0: np.ndarray, b1: np.ndarray) -> np.ndarray:
    """(..., 3) from the segment a0 a1 to the segment b0 b1 where they are nearest: clamped closest points, alternating.

    A few rounds of alternating projection; the distance is convex, so it only falls.
    """
    a, b, way = a1 - a0, b1 - b0, b0 - a0
    aa, ab, bb, aw, bw = ((one * other).sum(-1) for one, other in ((a, a), (a, b), (b, b), (a, way), (b, way)))
    on_a = on_b = np.full(ab.shape, 0.5)
    for _ in range(GAP_ROUNDS):
        on_a = ((aw + on_b * ab) / aa).clip(0, 1)
        on_b = ((on_a * ab - bw) / bb).clip(0, 1)
    return way + on_b[..., None] * b - on_a[..., None] * a


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
