"""What a fit is about: a hand of constant bones, its poses, its landmarks over time, and the camera that saw them.

Camera axes: x right, y down, z forward; right hands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.kinematics import ABDUCTION_SIDE, RANGES_DEG, ArticulatedHand
from jghand_engine.hand.rotations import vector_rotation

ANGLE_COUNT = 20
LIMITS_RAD = np.radians(RANGES_DEG.reshape(ANGLE_COUNT, 2))
# within the four angles of a finger: flexion and abduction of its first joint, flexion of its second and third
_FLEXIONS, _ABDUCTION = (0, 2, 3), 1
# numbers of one frame: turn of the palm, place of the wrist, angles
STATE_COUNT = 6 + ANGLE_COUNT
# some of the frames: a slice, or their numbers
Frames = slice | np.ndarray


@dataclass(frozen=True)
class JointChain:
    """A right hand of constant bones: joint angles to joints, with derivatives, in the frame of the canonical hand.

    It is `hand.kinematics.ArticulatedHand` in radians, without its limits: a fit must be able to look beyond them.

    palm_m:         (6, 3) wrist and first joints, wrist at the origin
    bones_m:        (3, 5, 3) the other bones of the straight hand
    flexion_axes:   (3, 5, 3) unit, about which positive angles turn
    abduction_axes: (5, 3) the same
    """

    palm_m: np.ndarray
    bones_m: np.ndarray
    flexion_axes: np.ndarray
    abduction_axes: np.ndarray

    @classmethod
    def of(cls, canonical_joints_m: np.ndarray) -> JointChain:
        """The chain of a canonical right hand, (21, 3) level order, meters."""
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


@dataclass(frozen=True)
class Pinhole:
    """focal_px, and the middle of the picture, pixels."""

    focal_px: float
    cx: float
    cy: float

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """(..., 3) camera axes -> (..., 2) pixels."""
        return self.focal_px * points_m[..., :2] / points_m[..., 2:] + (self.cx, self.cy)

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(..., 2) pixels -> (..., 3) directions with z = 1."""
        flat = (pixels - (self.cx, self.cy)) / self.focal_px
        return np.concatenate([flat, np.ones_like(flat[..., :1])], -1)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """One right hand over time, as it was seen.

    image_px: (F, 21, 2), NaN where it was not seen · directions: (F, 20, 3) unit, of bones 1..20, camera axes ·
    camera · fps
    """

    image_px: np.ndarray
    directions: np.ndarray
    camera: Pinhole
    fps: float

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool."""
        return np.asarray(np.isfinite(self.image_px).all(axis=(1, 2)))

    def part(self, frames: Frames) -> Landmarks:
        return replace(self, image_px=self.image_px[frames], directions=self.directions[frames])


@dataclass(frozen=True, eq=False)
class Poses:
    """turn: (F, 3, 3) camera from canonical hand · place_m: (F, 3) wrist, camera axes · angle_rad: (F, 20)."""

    turn: np.ndarray
    place_m: np.ndarray
    angle_rad: np.ndarray

    def __len__(self) -> int:
        return len(self.angle_rad)

    def part(self, frames: Frames) -> Poses:
        return Poses(self.turn[frames], self.place_m[frames], self.angle_rad[frames])

    def moved(self, step: np.ndarray) -> Poses:
        """After a step (F, 26)."""
        turn = self.turn @ vector_rotation(step[:, :3])
        return Poses(turn, self.place_m + step[:, 3:6], self.angle_rad + step[:, 6:])

    def steps(self) -> np.ndarray:
        """(F - 1, 26) how to come from each frame to the next."""
        between = np.swapaxes(self.turn[:-1], -1, -2) @ self.turn[1:]
        turns = Rotation.from_matrix(between).as_rotvec() if len(between) else np.zeros((0, 3))
        return np.concatenate([turns, np.diff(self.place_m, axis=0), np.diff(self.angle_rad, axis=0)], 1)

    def joints_m(self, chain: JointChain) -> np.ndarray:
        """(F, 21, 3) camera axes."""
        return chain.joints(self.angle_rad) @ np.swapaxes(self.turn, -1, -2) + self.place_m[:, None]

    def replaced(self, frames: np.ndarray, there: Poses) -> Poses:
        turn, place_m, angle_rad = self.turn.copy(), self.place_m.copy(), self.angle_rad.copy()
        turn[frames], place_m[frames], angle_rad[frames] = there.turn, there.place_m, there.angle_rad
        return Poses(turn, place_m, angle_rad)

    def spread(self, known: np.ndarray, count: int) -> Poses:
        """These poses, of the frames `known` (F,), rising, as poses of `count` frames: between known ones on the
        shortest way, held before the first one and after the last."""
        frames = np.clip(np.arange(count), known[0], known[-1])
        if len(known) == 1:
            return self.part(np.zeros(count, dtype=int))
        turn = Slerp(known, Rotation.from_matrix(self.turn))(frames).as_matrix()
        flat = np.concatenate([self.place_m, self.angle_rad], 1)
        between = np.stack([np.interp(frames, known, column) for column in flat.T], -1)
        # known ones stay as they are, to the last bit
        place = np.searchsorted(known, frames)
        exact = known[place] == frames
        turn[exact], between[exact] = self.turn[place[exact]], flat[place[exact]]
        return Poses(turn, between[:, :3], between[:, 3:])


def joined(parts: list[Poses]) -> Poses:
    return Poses(
        np.concatenate([part.turn for part in parts]),
        np.concatenate([part.place_m for part in parts]),
        np.concatenate([part.angle_rad for part in parts]),
    )
