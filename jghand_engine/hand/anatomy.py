"""What hands can do: ranges of the joints, poses with names, and motions through them. DATA 8, METHOD 4.1.

Angles here are anatomical, per finger, in degrees, because that is how tables of ranges read. Fingers: MCP flexion,
MCP abduction (positive away from the middle finger), PIP flexion, DIP flexion; flexion 0 is a straight finger,
abduction 0 the spread of the canonical hand. Thumb: CMC flexion (sweeps across the palm), CMC abduction, MCP and IP
flexion; 0 is the thumb of the canonical hand. So a named pose fits any canonical hand.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import torch
from scipy.optimize import lsq_linear

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.hand import rotations as rot
from jghand_engine.hand.frames import Swing
from jghand_engine.hand.joints import FINGERS, Handedness
from jghand_engine.hand.kinematics import decompose, forward_kinematics
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.hand.transform import JointTransform

# lowest and highest angle, degrees; (5 fingers, 4 angles, 2)
RANGES_DEG = np.array(
    [[(-15, 45), (-15, 35), (-10, 55), (-15, 85)]] + [[(-25, 92), (-22, 25), (-5, 112), (-8, 82)]] * 4, dtype=np.float64
)

# angles of five fingers, thumb first
POSES_DEG: dict[str, tuple[tuple[float, float, float, float], ...]] = {
    "open": ((0, 0, 0, 0), (4, 0, 8, 4), (6, 0, 8, 4), (6, 0, 8, 4), (6, 0, 8, 4)),
    "flat": ((2, -13, 0, 0), (0, -6, 0, 0), (0, 0, 0, 0), (0, -7, 0, 0), (0, -13, 0, 0)),
    "spread": ((-10, 18, -5, -5), (-3, 16, 2, 0), (-2, 0, 2, 0), (-3, 14, 2, 0), (-3, 22, 2, 0)),
    "relaxed": ((10, 5, 10, 12), (22, 0, 36, 18), (28, 0, 38, 19), (31, 0, 42, 20), (33, 3, 42, 22)),
    "fist": ((16, -15, 44, 44), (84, 0, 106, 66), (88, 0, 109, 67), (88, 0, 108, 66), (86, 0, 104, 64)),
    "point": ((20, -15, 46, 44), (4, 0, 6, 4), (86, 0, 108, 66), (88, 0, 108, 66), (86, 0, 104, 64)),
    "victory": ((27, -14, 46, 40), (4, 11, 6, 4), (4, -9, 6, 4), (86, 0, 108, 66), (86, 0, 104, 64)),
    "three": ((34, -12, 46, 42), (4, 10, 5, 3), (4, 0, 5, 3), (4, 9, 5, 3), (82, 0, 102, 62)),
    "four": ((36, -12, 46, 44), (4, 10, 5, 3), (4, 0, 5, 3), (4, 8, 5, 3), (4, 16, 5, 3)),
    "thumb_up": ((-12, 14, -6, -12), (86, 0, 108, 66), (88, 0, 109, 67), (88, 0, 108, 66), (86, 0, 104, 64)),
    "pinch": ((24, 12, 18, 28), (50, 0, 54, 32), (34, 0, 36, 21), (32, 0, 34, 18), (30, 3, 32, 18)),
    "ok": ((24, 12, 18, 30), (52, 0, 56, 34), (16, 0, 17, 9), (11, 4, 14, 6), (6, 10, 12, 6)),
    "rock": ((22, -15, 46, 44), (4, 4, 6, 4), (86, 0, 108, 66), (86, 0, 106, 64), (4, 8, 6, 4)),
    "call": ((-8, 24, -5, -8), (84, 0, 106, 66), (88, 0, 109, 67), (86, 0, 106, 65), (2, 18, 6, 4)),
    "claw": ((5, 12, 25, 40), (-4, 8, 84, 52), (-4, 0, 84, 54), (-4, 6, 84, 52), (-4, 12, 80, 50)),
    "grasp": ((22, 16, 20, 25), (54, 4, 52, 30), (56, 0, 52, 32), (58, 3, 52, 30), (58, 8, 50, 30)),
    "table": ((8, 5, 5, 5), (84, 0, 8, 4), (86, 0, 8, 4), (86, 0, 8, 4), (84, 0, 8, 4)),
}


class Contact(StrEnum):
    """Where the thumb's tip meets a finger: at its tip, or resting on the back of its middle phalanx."""

    TIP = "tip"
    REST = "rest"


# poses in which the thumb's tip touches a finger (1 index .. 4 pinky): the angles are solved for each hand
CONTACTS = {
    "pinch": (Contact.TIP, 1),
    "ok": (Contact.TIP, 1),
    "fist": (Contact.REST, 2),
    "point": (Contact.REST, 2),
    "victory": (Contact.REST, 3),
    "three": (Contact.REST, 4),
    "rock": (Contact.REST, 2),
}
# +abduction turns index and middle to the thumb's side, ring and pinky to the other
ABDUCTION_SIDE = torch.tensor([1.0, 1.0, 1.0, -1.0, -1.0], dtype=torch.float64)
# out of the palm for the thumb, in the palm frame (out of the palm, towards the thumb, distal); DATA 8
_THUMB_NORMAL = torch.tensor([0.59, -0.80, -0.10], dtype=torch.float64)

# ranges of the angles in the frames of the transform, degrees: flexion and abduction of bones 6..20 (METHOD 4.1);
# used to normalize features
FRAME_RANGES_DEG = np.array(
    [
        [(-20, 130), (-80, 80)] if finger == 0 else [flexion, (-abduction, abduction)]
        for flexion, abduction in (((-30, 100), 35), ((-10, 115), 15), ((-20, 90), 15))
        for finger in range(5)
    ],
    dtype=np.float64,
)


def pose_names() -> tuple[str, ...]:
    """The poses that have a name."""
    return tuple(POSES_DEG)


def named_angles(name: str) -> np.ndarray:
    """(5, 4) angles of a named pose, degrees; InputError lists the names."""
    if name not in POSES_DEG:
        raise InputError("pose", wanted=f"one of {', '.join(POSES_DEG)}", came=repr(name))
    return np.array(POSES_DEG[name], dtype=np.float64)


def named_pose(name: str, canonical_joints_m: np.ndarray, *, handedness: Handedness) -> np.ndarray:
    """(21, 3) level-order joints of a named pose, meters; wrist and palm stay where the canonical hand has them.

    canonical_joints_m: (21, 3) right hand. A left hand is the mirror image, x negated.
    """
    hand = ArticulatedHand(canonical_joints_m)
    return _handed(hand.joints(hand.angles_of(name)[None])[0], handedness)


class ArticulatedHand:
    """A canonical hand that can be posed by anatomical angles; bones keep the canonical lengths exactly."""

    def __init__(self, canonical_joints_m: np.ndarray) -> None:
        canonical = torch.from_numpy(np.array(canonical_joints_m, dtype=np.float64))
        transform = JointTransform(canonical, handedness=Handedness.RIGHT, swing=Swing.EULER)
        pose = decompose(transform, canonical)
        # straight fingers that keep their spread and their natural sideways bends; the thumb stays as it is
        straight = pose.angles.reshape(3, 5, 2).clone()
        straight[:, 1:, 0] = 0.0
        neutral = forward_kinematics(transform, dataclasses.replace(pose, angles=straight.reshape(15, 2)))
        self._neutral = neutral
        self._length_m = float(pose.length_m[[2, 7, 12, 17]].sum())
        # bones, flexion and abduction axes of the three moving joints of each finger: (3, joint, finger)
        self._bones = (neutral[6:] - neutral[1:16]).T.reshape(3, 3, 5)
        direction = self._bones / self._bones.norm(dim=0)
        palm_normal = pose.palm[:, 0]
        normal = torch.stack([pose.palm @ _THUMB_NORMAL, *[palm_normal] * 4], -1).unsqueeze(1)
        normal = normal - rot.dot(normal, direction) * direction
        self._abduction_axis = normal / normal.norm(dim=0)
        self._flexion_axis = rot.cross(direction, self._abduction_axis)

    def joints(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) angles, degrees, clamped to RANGES_DEG -> (F, 21, 3) joints, meters."""
        turns = self._turns(angles_deg)
        first = self._neutral[:6].T.unsqueeze(-1).expand(3, 6, turns[0].shape[-1])
        parts = [first[:, :1], first[:, 1:]]
        for joint, turn in enumerate(turns):
            parts.append(parts[-1] + rot.mat_vec(turn, self._bones[:, joint].unsqueeze(-1)))
        return torch.cat(parts, 1).permute(2, 1, 0).numpy()

    @property
    def straight_joints_m(self) -> np.ndarray:
        """(21, 3) joints of the hand whose fingers are straight: what `turns` turns. Meters, level order."""
        return self._neutral.numpy()

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """(3, 5, 3) flexion and abduction axes of the three moving bones of each finger in the straight hand."""
        return self._flexion_axis.permute(1, 2, 0).numpy(), self._abduction_axis.permute(1, 2, 0).numpy()

    def turns(self, angles_deg: np.ndarray) -> np.ndarray:
        """(F, 5, 4) angles, degrees, clamped to RANGES_DEG -> (F, 3, 5, 3, 3) rotations of the three moving bones of
        each finger, from where they point in the straight hand."""
        return torch.stack(self._turns(angles_deg)).permute(4, 0, 3, 1, 2).numpy()

    def _turns(self, angles_deg: np.ndarray) -> list[torch.Tensor]:
        """The same as three matrices (3, 3, finger, frame)."""
        clamped = np.clip(np.asarray(angles_deg, dtype=np.float64), RANGES_DEG[..., 0], RANGES_DEG[..., 1])
        # (angle, finger, frame)
        angle = torch.from_numpy(np.radians(clamped)).permute(2, 1, 0)
        turn = rot.axis_rotation(self._abduction_axis[:, 0].unsqueeze(-1), -ABDUCTION_SIDE.unsqueeze(-1) * angle[1])
        turns = []
        for joint, flexion in enumerate((angle[0], angle[2], angle[3])):
            turn = rot.mat_mul(turn, rot.axis_rotation(self._flexion_axis[:, joint].unsqueeze(-1), flexion))
            turns.append(turn)
        return turns

    def angles_of(self, name: str) -> np.ndarray:
        """(5, 4) angles of a named pose on this hand, degrees: the table's, solved for contact where tips touch."""
        angles = np.clip(named_angles(name), RANGES_DEG[..., 0], RANGES_DEG[..., 1])
        return self.touching(angles, *CONTACTS[name]) if name in CONTACTS else angles

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
        pull = np.eye(len(start)) / limits.TOUCH_PULL_DEG
        value = start.copy()
        for _ in range(limits.TOUCH_STEPS):
            # the gap at the value and, for the Jacobian, beside it in each angle: inwards, as joints stop at the range
            aside = np.where(value < (low + high) / 2, limits.TOUCH_DIFFERENCE_DEG, -limits.TOUCH_DIFFERENCE_DEG)
            trials = np.repeat(angles[None], len(start) + 1, axis=0)
            trials[:, rows, cols] = value
            trials[np.arange(1, len(start) + 1), rows, cols] += aside
            gap = self._gap(self.joints(trials), contact, finger) / (limits.TOUCH_PART * self._length_m)
            jacobian = (gap[1:] - gap[0]).T / aside
            residual = np.concatenate([gap[0], (value - start) / limits.TOUCH_PULL_DEG])
            within = (low - value, high - value)
            step = lsq_linear(np.concatenate([jacobian, pull]), -residual, within, method="bvls").x
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
        return (start + end) / 2 + limits.TOUCH_THICKNESS_PART * self._length_m * back - tip


@dataclass(frozen=True)
class MotionOptions:
    """How a motion through named poses moves: rate, seconds of a move and of a stop, the largest delay of a finger
    as a part of the move, random variation of the poses, degrees, and the seed of both."""

    fps: float = 30.0
    move_s: float = 0.7
    hold_s: float = 0.25
    finger_delay: float = 0.25
    variation_deg: float = 0.0
    seed: int = 0

    def check(self) -> None:
        """InputError names the option that cannot be."""
        lowest, highest = limits.FPS_MIN, limits.FPS_MAX
        checks = (
            ("fps", lowest <= self.fps <= highest, f"{lowest:g} to {highest:g} frames per second"),
            ("move_s", 0 <= self.move_s < math.inf, "seconds >= 0"),
            ("hold_s", 0 <= self.hold_s < math.inf, "seconds >= 0"),
            ("finger_delay", 0 <= self.finger_delay < 1, "a part from 0 to below 1"),
            ("variation_deg", 0 <= self.variation_deg < math.inf, "degrees >= 0"),
            ("seed", self.seed >= 0, "0 or a positive number"),
        )
        for name, good, wanted in checks:
            if not good:
                raise InputError(f"motion option {name}", wanted=wanted, came=str(getattr(self, name)))


def minimum_jerk(part: np.ndarray) -> np.ndarray:
    """10 u^3 - 15 u^4 + 6 u^5: from 0 to 1 with speed and acceleration 0 at both ends, as hands move."""
    u = np.clip(part, 0.0, 1.0)
    return u**3 * (10 - 15 * u + 6 * u**2)


def pose_sequence_of_names(
    names: Sequence[str],
    canonical_joints_m: np.ndarray,
    *,
    handedness: Handedness,
    options: MotionOptions | None = None,
) -> PoseSequence:
    """A motion through named poses: minimum jerk, each finger a little late, the wrist at rest.

    canonical_joints_m: (21, 3) right hand, level order, meters; its bone lengths are kept exactly.
    """
    options = options or MotionOptions()
    if not names:
        raise InputError("poses of a motion", wanted="at least one name", came="none")
    options.check()
    hand = ArticulatedHand(canonical_joints_m)
    random = np.random.default_rng(options.seed)
    solved = {name: hand.angles_of(name) for name in dict.fromkeys(names)}
    keys = [solved[name] + options.variation_deg * random.standard_normal((5, 4)) for name in names]
    move = max(1, round(options.move_s * options.fps))
    hold = round(options.hold_s * options.fps)
    frames = [keys[0]] * (1 + hold)
    for start, end in itertools.pairwise(keys):
        delay = random.uniform(0.0, options.finger_delay, (len(FINGERS), 1))
        for time in np.arange(1, move + 1) / move:
            frames.append(start + (end - start) * minimum_jerk((time - delay) / (1 - delay)))
        frames += [end] * hold
    joints = hand.joints(np.stack(frames))
    return PoseSequence(_handed(joints, handedness), options.fps, handedness)


def _handed(joints: np.ndarray, handedness: Handedness) -> np.ndarray:
    return joints * np.array([-1.0, 1.0, 1.0]) if Handedness(handedness) is Handedness.LEFT else joints
