"""What of a pose sequence goes into files: posed Gaussians frame by frame, and the bones of all frames in parts.

Nothing is held of a long take but its joints.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.posing import PosedHand, Posing
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.export.splats.cloud import RUB_FROM_UP
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence

# frames whose bones are made at once
BATCH_FRAMES = 24
# columns of an engine frame (x, y, z) that become x, y, z of a joint: flexion axis, along the bone, out of the palm
JOINT_AXES = (1, 2, 0)
MIRROR = np.diag([-1.0, 1.0, 1.0])
TURN_FLEXION_AXIS = np.diag([1.0, -1.0, 1.0])
# places of xx, xy, xz, yy, yz, zz in a symmetric matrix, row by row
SYMMETRIC = [0, 1, 2, 1, 3, 4, 2, 4, 5]


@dataclass(frozen=True)
class BonePoses:
    """Where the engine puts the bones of F frames, level order, in the world of the hand itself.

    joints_m: (F, 21, 3) meters
    axes:     (F, 21, 3, 3) joint axes of every bone, row 0 the palm's
    scales:   (F, 21, 3) along those axes
    """

    joints_m: np.ndarray
    axes: np.ndarray
    scales: np.ndarray


class HandMotion:
    """An avatar driven by a sequence, of the hand the sequence names.

    A trained avatar is posed with its offsets, light and shade; what it mirrors depends on the camera, and is left out.
    light: of a scene, as `Posing` has it; None: what the avatar carries. up: the axis of the motion's world, y or z,
    that points up: light is y up, wherever it is from. Raises InputError for a sequence with gaps, and for an avatar
    whose bones do not end at the joints, or that no scene can light.
    """

    def __init__(
        self, avatar: HandAvatar, sequence: PoseSequence, light: SceneLight | None = None, up: str = "y"
    ) -> None:
        self.sequence = sequence.without_gaps()
        self.handedness = sequence.handedness
        self.avatar = avatar.for_hand(self.handedness)
        self._skeleton = self.avatar.skeleton()
        self._joints_m = sequence.joints_m
        self._posing, self._light_from_world = Posing(self.avatar, light=light), RUB_FROM_UP[up]
        learned = avatar.learned
        carried = "capture" if learned is None or learned.response is None else "studio"
        # whose light the colors show; paint has none
        self.light = "none" if learned is None else carried if light is None else "scene"

    def __len__(self) -> int:
        return len(self._joints_m)

    @property
    def mean_scale(self) -> float:
        """Scale of the whole hand against the canonical one, mean over the frames."""
        return sum(self._skeleton.bones(joints_m).scale for joints_m in self._joints_m) / len(self)

    def frame(self, index: int) -> PosedHand:
        return turned(self._posing(self._joints_m[index] @ self._light_from_world.T), self._light_from_world.T)

    def rest(self) -> PosedHand:
        """The Gaussians of the canonical hand, with what the avatar has learned of such a pose."""
        return self._posing(self._rest_joints_m)

    @property
    def colors_move(self) -> bool:
        """Whether the colors change with the pose: those of a trained avatar turn in its light."""
        return self.avatar.learned is not None

    @property
    def has_ellipsoids(self) -> bool:
        """Whether the Gaussians are no balls: their sizes and turns then change with the pose."""
        return self.avatar.learned is not None and self.avatar.learned.ellipsoid is not None

    def rest_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The Gaussians at rest, float32: canonical centers (N, 3), mirrored for a left hand, and radii (N,) at the
        mean scale of the motion, meters; opacity (N,); colors (N, 3), where they change those of the first frame."""
        avatar, rgb = self.avatar, self.frame(0).rgb
        return (
            self._mirrored(np.asarray(avatar.position_m)).astype(np.float32),
            (np.asarray(avatar.sigma_m) * self.mean_scale).astype(np.float32),
            np.asarray(avatar.opacity, np.float32),
            np.asarray(avatar.rgb if rgb is None else rgb, np.float32),
        )

    def rest_poses(self) -> BonePoses:
        """The canonical hand as one frame."""
        return self._poses(self._rest_joints_m[None])

    def poses(self) -> Iterator[BonePoses]:
        for first in range(0, len(self), BATCH_FRAMES):
            yield self._poses(self._joints_m[first : first + BATCH_FRAMES])

    @property
    def _rest_joints_m(self) -> np.ndarray:
        return self._mirrored(np.asarray(self.avatar.canonical_joints_m, np.float64))

    def _mirrored(self, points_m: np.ndarray) -> np.ndarray:
        """Canonical points (..., 3) of the hand itself: the mirror image of the model's for a left hand."""
        return points_m @ MIRROR.astype(points_m.dtype) if self.handedness is Handedness.LEFT else points_m

    def _poses(self, joints_m: np.ndarray) -> BonePoses:
        bones = [self._skeleton.bones(pose_m, np.float64) for pose_m in joints_m]
        frames, scales = (np.stack(parts) for parts in zip(*map(self._skeleton.frames, bones), strict=True))
        return BonePoses(joints_m, joint_axes(frames, self.handedness), scales[..., JOINT_AXES])


def turned(posed: PosedHand, turn: np.ndarray) -> PosedHand:
    """The same after a turn (3, 3)."""
    if np.array_equal(turn, np.eye(3)):
        return posed
    covariance_m2 = posed.covariance_m2
    if covariance_m2 is not None:
        covariance_m2 = (turn @ covariance_m2[:, SYMMETRIC].reshape(-1, 3, 3) @ turn.T).reshape(-1, 9)
        covariance_m2 = covariance_m2[:, [0, 1, 2, 4, 5, 8]].astype(np.float32)
    return replace(posed, position_m=(posed.position_m @ turn.T).astype(np.float32), covariance_m2=covariance_m2)


def joint_axes(frames: np.ndarray, handedness: Handedness) -> np.ndarray:
    """Engine frames (..., 3, 3) of the *right-hand* code, columns x, y, z, to proper joint axes in the hand's world."""
    if handedness is Handedness.LEFT:
        frames = MIRROR @ frames @ TURN_FLEXION_AXIS
    return frames[..., JOINT_AXES]
