"""A hand of constant bones: joint angles to joints, with derivatives. Right hands; the left is mirrored before.

It is `hand.kinematics.ArticulatedHand` once more, in radians, without the limits (a fit must be able to look beyond
them) and with what a fit needs: how each joint moves when an angle changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.kinematics import ABDUCTION_SIDE, RANGES_DEG, ArticulatedHand
from jghand_engine.hand.rotations import vector_rotation

ANGLE_COUNT = 20
LIMITS_RAD = np.radians(RANGES_DEG.reshape(ANGLE_COUNT, 2))
# within the four angles of a finger: flexion and abduction of its first joint, flexion of its second and third
_FLEXIONS, _ABDUCTION = (0, 2, 3), 1


@dataclass(frozen=True)
class Skeleton:
    """palm_m: (6, 3) wrist and first joints, wrist at the origin · bones_m: (3, 5, 3) the other bones of the straight
    hand · flexion_axes: (3, 5, 3) and abduction_axes: (5, 3), unit, about which positive angles turn; all in the frame
    of the canonical hand."""

    palm_m: np.ndarray
    bones_m: np.ndarray
    flexion_axes: np.ndarray
    abduction_axes: np.ndarray

    @classmethod
    def of(cls, canonical_joints_m: np.ndarray) -> Skeleton:
        """The skeleton of a canonical right hand, (21, 3) level order, meters."""
        hand = ArticulatedHand(canonical_joints_m)
        straight = hand.straight_joints_m
        bones = (straight[6:] - straight[1:16]).reshape(3, 5, 3)
        sides = -ABDUCTION_SIDE[:, None]
        return cls(straight[:6] - straight[0], bones, hand.flexion_axes, sides * hand.abduction_axes[0])

    @property
    def bone_lengths_m(self) -> np.ndarray:
        """(20,) level order."""
        return np.linalg.norm(np.concatenate([self.palm_m[1:], self.bones_m.reshape(15, 3)]), axis=-1)

    def joints(self, angle_rad: np.ndarray) -> np.ndarray:
        """(F, 20) angles, finger by finger -> (F, 21, 3) joints, level order, wrist at the origin, meters."""
        return self._chain(angle_rad)[0]

    def joints_and_motion(self, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The joints, and how they move: (F, 21, 3, 20), meters per radian."""
        joints, axes = self._chain(angle_rad)
        motion = np.zeros((len(joints), JOINT_COUNT, 3, 5, 4))
        fingers = np.arange(5)
        for angle, pivot_level in ((0, 0), (1, 0), (2, 1), (3, 2)):
            pivot = joints[:, 1 + 5 * pivot_level : 6 + 5 * pivot_level]
            for level in range(pivot_level + 1, 4):
                moved = slice(1 + 5 * level, 6 + 5 * level)
                turned = np.cross(axes[:, angle], joints[:, moved] - pivot)
                motion[:, 1 + 5 * level + fingers, :, fingers, angle] = turned.transpose(1, 0, 2)
        return joints, motion.reshape(len(joints), JOINT_COUNT, 3, ANGLE_COUNT)

    def _chain(self, angle_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Joints, and the axes (F, 4, 5, 3) of the four angles where the fingers are."""
        angle = np.asarray(angle_rad, dtype=np.float64).reshape(-1, 5, 4)
        count = len(angle)
        joints = np.empty((count, JOINT_COUNT, 3))
        joints[:, :6] = self.palm_m
        axes = np.empty((count, 4, 5, 3))
        axes[:, _ABDUCTION] = self.abduction_axes
        turn = vector_rotation(self.abduction_axes * angle[..., _ABDUCTION, None])
        for joint, which in enumerate(_FLEXIONS):
            axis = self.flexion_axes[joint]
            axes[:, which] = np.einsum("nfij,fj->nfi", turn, axis)
            turn = turn @ vector_rotation(axis * angle[..., which, None])
            bone = np.einsum("nfij,fj->nfi", turn, self.bones_m[joint])
            joints[:, 6 + 5 * joint : 11 + 5 * joint] = joints[:, 1 + 5 * joint : 6 + 5 * joint] + bone
        return joints, axes
