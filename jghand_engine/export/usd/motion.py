"""What of a pose sequence goes into a stage: posed Gaussians frame by frame, and the bones of all frames in parts.

Nothing is held of a long take but its joints.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar, check_follows_joints
from jghand_engine.avatar.fast_posing import FastPosing, PosedFrame
from jghand_engine.avatar.skinning import pose_gaussians
from jghand_engine.errors import InputError
from jghand_engine.export.usd.skeleton import JOINT_AXES, MIRROR, BonePoses, joint_axes
from jghand_engine.export.usd.splats import Cloud
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.hand.transform import BoneTransforms
from jghand_engine.limits import USD_SAVE_EVERY
from jghand_engine.native import library


class HandMotion:
    """An avatar driven by a sequence, of the hand the sequence names.

    A trained avatar is posed with its offsets, light and shade; what it mirrors depends on the camera, and is left out.
    Raises InputError for a sequence with gaps, and for an avatar whose bones do not end at the joints.
    """

    def __init__(self, avatar: HandAvatar, sequence: PoseSequence) -> None:
        check_sequence(sequence)
        check_follows_joints(avatar)
        self.handedness = Handedness(sequence.handedness)
        self.avatar = avatar.for_hand(self.handedness)
        self._transform = self.avatar.bone_transform()
        self.sequence = sequence
        self._joints_m = torch.tensor(sequence.joints_m, dtype=torch.float64)
        native = library.load()
        self._fast = None if native is None else FastPosing(native, self.avatar)

    def __len__(self) -> int:
        return len(self._joints_m)

    @property
    def mean_scale(self) -> float:
        """Scale of the whole hand against the canonical one, mean over the frames."""
        return sum(float(bones.scale.sum()) for _, bones in self._batches()) / len(self)

    def wrist_m(self, index: int) -> np.ndarray:
        """(3,) float64 where the wrist is in one frame, meters."""
        return self._joints_m[index, 0].numpy()

    def frame(self, index: int) -> PosedFrame:
        """The Gaussians as the engine draws them in one frame."""
        return self._posed(self._joints_m[index])

    def rest(self) -> PosedFrame:
        """The Gaussians of the canonical hand, with what the avatar has learned of such a pose."""
        return self._posed(torch.as_tensor(self.mirrored(self.avatar.canonical_joints_m.numpy().astype(np.float64))))

    def _posed(self, joints_m: torch.Tensor) -> PosedFrame:
        if self._fast is not None:
            return self._fast(joints_m.numpy())
        # pose_gaussians works in the precision of its bones; positions are stored as float32
        bones = _in_precision(self._transform.bones(joints_m), torch.float32)
        with torch.inference_mode():
            gaussians = pose_gaussians(self.avatar, bones, frames=bones.frames)
        rgb = gaussians.rgb.clamp(0, 1).numpy() if self.colors_move else None
        covariance = None if gaussians.covariance_m2 is None else gaussians.covariance_m2.numpy()
        return PosedFrame(gaussians.position_m.numpy(), gaussians.sigma_m.numpy(), rgb, covariance)

    @property
    def colors_move(self) -> bool:
        """Whether the colors change with the pose: those of a trained avatar turn in its light."""
        return self.avatar.learned is not None

    @property
    def has_ellipsoids(self) -> bool:
        """Whether the Gaussians are no balls: their sizes and turns then change with the pose."""
        return self.avatar.learned is not None and self.avatar.learned.ellipsoid is not None

    def cloud(self) -> Cloud:
        """The Gaussians at rest: canonical, mirrored for a left hand; radii at the mean scale of the motion; colors
        that change are those of the first frame."""
        avatar = self.avatar
        rgb = self.frame(0).rgb
        return Cloud(
            rest_m=self.mirrored(avatar.position_m.numpy()).astype(np.float32),
            sigma_m=(avatar.sigma_m.numpy() * self.mean_scale).astype(np.float32),
            opacity=avatar.opacity.numpy().astype(np.float32),
            rgb=(avatar.rgb.numpy() if rgb is None else rgb).astype(np.float32),
        )

    def mirrored(self, points_m: np.ndarray) -> np.ndarray:
        """Canonical points (..., 3) of the hand itself: the mirror image of the model's for a left hand."""
        return points_m @ MIRROR.astype(points_m.dtype) if self.handedness is Handedness.LEFT else points_m

    def rest_poses(self) -> BonePoses:
        """The canonical hand as one frame."""
        joints_m = torch.as_tensor(self.mirrored(self.avatar.canonical_joints_m.numpy().astype(np.float64)))[None]
        return self._poses(joints_m, self._transform.bones(joints_m))

    def poses(self) -> Iterator[BonePoses]:
        """The bones of every frame, USD_SAVE_EVERY frames at a time."""
        for joints_m, bones in self._batches():
            yield self._poses(joints_m, bones)

    def _batches(self) -> Iterator[tuple[torch.Tensor, BoneTransforms]]:
        for joints_m in self._joints_m.split(USD_SAVE_EVERY):
            yield joints_m, self._transform.bones(joints_m)

    def _poses(self, joints_m: torch.Tensor, bones: BoneTransforms) -> BonePoses:
        posed = _all_frames(bones.frames.S, bones.frames.S0)
        canonical = self._transform.canonical
        # the canonical hand keeps its batch last and its components first
        canonical_frames = _all_frames(
            canonical.S.squeeze(-1).permute(2, 0, 1)[None], canonical.S0.squeeze(-1).squeeze(-1)[None]
        )
        linear = bones.linear.numpy()
        if self.handedness is Handedness.LEFT:
            linear = MIRROR @ linear
        # L = S diag(r, r, s) S^cT: the diagonal, also where a bone has no length and L no inverse
        scales = (posed * (linear @ canonical_frames)).sum(axis=-2)
        return BonePoses(joints_m.numpy(), joint_axes(posed, self.handedness), scales[..., JOINT_AXES])


def check_sequence(sequence: PoseSequence) -> None:
    """Raises InputError when joints are missing in any frame."""
    if sequence.gaps:
        raise InputError(
            "motion",
            wanted="all 21 joints in every frame",
            came=sequence.gaps.sentence(),
            remedy="Hold the last good pose over the gaps (PoseSequence.with_gaps_held) or cut these frames.",
        )


def _all_frames(S: torch.Tensor, S0: torch.Tensor) -> np.ndarray:
    """(F, 21, 3, 3): the palm's frame and those of bones 1..20."""
    return torch.cat([S0.unsqueeze(-3), S], dim=-3).numpy()


def _in_precision(bones: BoneTransforms, dtype: torch.dtype) -> BoneTransforms:
    names = ("linear", "offset_m", "root_m", "canonical_root_m", "scale")
    return dataclasses.replace(bones, **{name: getattr(bones, name).to(dtype) for name in names})
