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
from jghand_engine.errors import InputError
from jghand_engine.export.splats.cloud import RUB_FROM_UP
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import HandPose, PoseSequence
from jghand_engine.template.mesh import HandTemplate

# frames whose bones are made at once
BATCH_FRAMES = 24
# columns of an engine frame (x, y, z) that become x, y, z of a joint: flexion axis, along the bone, out of the palm
JOINT_AXES = (1, 2, 0)
MIRROR = np.diag([-1.0, 1.0, 1.0])
TURN_FLEXION_AXIS = np.diag([1.0, -1.0, 1.0])


@dataclass(frozen=True)
class BonePoses:
    """Where the engine puts the bones of F frames, level order, in the world of the hand itself.

    joints_m: (F, 21, 3) meters
    axes:     (F, 21, 3, 3) joint axes of every bone, row 0 the palm's; behind them those of a forearm's slices, which
              turn about the wrist
    scales:   (F, as many, 3) along those axes
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

    def frame(self, index: int) -> PosedHand:
        pose, turn = self.sequence.pose(index), self._light_from_world
        posed = self._posing(pose.joints_m @ turn.T, pose.forearm)
        return replace(posed, position_m=(posed.position_m @ turn).astype(np.float32))

    @property
    def colors_move(self) -> bool:
        """Whether the colors change with the pose: those of a trained avatar turn in its light."""
        return self.avatar.learned is not None

    def rest_arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The Gaussians at rest, float32: canonical centers (N, 3), mirrored for a left hand, and radii (N,) at the
        mean scale of the motion, meters; opacity (N,); colors (N, 3), where they change those of the first frame."""
        avatar, rgb = self.avatar, self.frame(0).rgb
        mean_scale = sum(self._skeleton.bones(joints_m).scale for joints_m in self._joints_m) / len(self)
        return (
            self._mirrored(np.asarray(avatar.position_m)).astype(np.float32),
            (np.asarray(avatar.sigma_m) * mean_scale).astype(np.float32),
            np.asarray(avatar.opacity, np.float32),
            np.asarray(avatar.rgb if rgb is None else rgb, np.float32),
        )

    def rest_poses(self) -> BonePoses:
        """The canonical hand as one frame."""
        return self._poses([HandPose(self._mirrored(np.asarray(self.avatar.canonical_joints_m, np.float64)))])

    def poses(self) -> Iterator[BonePoses]:
        for first in range(0, len(self), BATCH_FRAMES):
            yield self._poses([self.sequence.pose(i) for i in range(first, min(first + BATCH_FRAMES, len(self)))])

    def map_weights(self, skin: HandTemplate) -> np.ndarray:
        """(V, maps) weights of all maps of the vertices of a surface that is the hand itself."""
        return self.avatar.map_weights(self._mirrored(skin.vertices_m), skin.bone_weights)

    def _mirrored(self, points_m: np.ndarray) -> np.ndarray:
        """Canonical points (..., 3) of the hand itself: the mirror image of the model's for a left hand."""
        return points_m @ MIRROR.astype(points_m.dtype) if self.handedness is Handedness.LEFT else points_m

    def _poses(self, poses: list[HandPose]) -> BonePoses:
        bones = [self._skeleton.bones(pose.joints_m, np.float64, forearm=pose.forearm) for pose in poses]
        frames, scales = (np.stack(parts) for parts in zip(*map(self._skeleton.frames, bones), strict=True))
        if self.handedness is Handedness.LEFT:  # from the right-hand code's to proper axes in the hand's world
            frames = MIRROR @ frames @ TURN_FLEXION_AXIS
        joints_m = np.stack([pose.joints_m for pose in poses])
        return BonePoses(joints_m, frames[..., JOINT_AXES], scales[..., JOINT_AXES])


def check_balls(avatar: HandAvatar) -> None:
    """InputError for an avatar that trained with ellipsoids, as one row of the ablation does: files hold balls."""
    if avatar.learned is not None and avatar.learned.ellipsoid is not None:
        raise InputError(
            avatar.info.name,
            wanted="Gaussians that are balls",
            came="ellipsoids",
            remedy="Render it, or export a mesh.",
        )
