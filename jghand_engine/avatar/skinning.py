"""Posing an avatar: linear blend skinning of its Gaussians by the 21 bone transforms (METHOD 2.8, 2.9).

This is the differentiable form, in any floating dtype; the native path of the renderer is tested against it.
"""

from __future__ import annotations

from typing import Protocol

import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.gaussians import Gaussians
from jghand_engine.limits import BLEND_DET_MIN, SIGMA_STRETCH_MAX, SIGMA_STRETCH_MIN


class PoseTransforms(Protocol):
    """What skinning needs to know of `hand.transform.BoneTransforms` of one pose.

    linear (21, 3, 3) and offset_m (21, 3): x_posed - root = linear @ (x - canonical root) + offset.
    """

    @property
    def linear(self) -> torch.Tensor: ...
    @property
    def offset_m(self) -> torch.Tensor: ...
    @property
    def root_m(self) -> torch.Tensor: ...
    @property
    def canonical_root_m(self) -> torch.Tensor: ...
    @property
    def scale(self) -> torch.Tensor: ...


def blend(bone_weights: torch.Tensor, bones: PoseTransforms) -> tuple[torch.Tensor, torch.Tensor]:
    """The blended affine map of every point: linear (N, 3, 3) and root-relative offset (N, 3), metres.

    A sum of products, never a matrix product: GEMM loses 0.7 mm under autocast and on TF32 hardware (METHOD 2.10).
    """
    flat = torch.cat([bones.linear.flatten(-2), bones.offset_m], -1)
    weights = bone_weights.to(flat.dtype)
    total = weights[:, :1] * flat[0]
    for bone in range(1, flat.shape[0]):
        total = torch.addcmul(total, weights[:, bone : bone + 1], flat[bone])
    return total[:, :9].unflatten(-1, (3, 3)), total[:, 9:]


def apply(linear: torch.Tensor, vector: torch.Tensor) -> torch.Tensor:
    """linear (..., 3, 3) times vector (..., 3) by multiply-add, without GEMM."""
    return (linear * vector.unsqueeze(-2)).sum(-1)


def volume_scale(linear: torch.Tensor, hand_scale: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """|det L|^(1/3) of linear (N, 3, 3), and where the guard |det L| >= BLEND_DET_MIN * s_g^3 holds (N,) bool.

    Below the guard the value is that of the guard and the gradient zero, never infinite.
    """
    det = (linear[..., 0] * torch.linalg.cross(linear[..., 1], linear[..., 2])).sum(-1).abs()
    floor = BLEND_DET_MIN * hand_scale.abs() ** 3
    sound = det > floor
    return torch.where(sound, det, floor) ** (1.0 / 3.0), sound


def posed_radius_scale(linear: torch.Tensor, hand_scale: torch.Tensor) -> torch.Tensor:
    """(N,) posed radius / canonical radius: |det L|^(1/3), clamped to SIGMA_STRETCH_MIN..MAX times s_g (METHOD 2.8)."""
    size, _ = volume_scale(linear, hand_scale)
    return torch.clamp(size, SIGMA_STRETCH_MIN * hand_scale, SIGMA_STRETCH_MAX * hand_scale)


def turning(linear: torch.Tensor, bones: PoseTransforms) -> torch.Tensor:
    """The blended rotation (up to shear) L / |det L|^(1/3), (N, 3, 3); the palm's where the blend has collapsed.

    It turns what is attached to the skin in canonical axes, such as a learnt offset, with the hand (METHOD 2.9).
    """
    size, sound = volume_scale(linear, bones.scale)
    palm = bones.linear[0] / bones.scale
    return torch.where(sound[:, None, None], linear / size[:, None, None], palm)


def pose_gaussians(
    avatar: HandAvatar, bones: PoseTransforms, *, pose_offset_m: torch.Tensor | None = None
) -> Gaussians:
    """Canonical Gaussians -> Gaussians of one pose, in the frame of the joints that made `bones`.

    bones:         transforms of one pose (no batch axis); its dtype is that of the result.
    pose_offset_m: (N, 3) metres, offsets in canonical axes added after skinning, turned and scaled with the hand.

    Position: blend [L | t] root-relative, add the root last (METHOD 2.9): the result stays exact far from the origin.
    Radius: sigma * |det L|^(1/3), clamped to SIGMA_STRETCH_MIN..MAX times s_g * sigma (METHOD 2.8).
    """
    with torch.autocast(bones.linear.device.type, enabled=False):
        dtype = bones.linear.dtype
        linear, offset_m = blend(avatar.bone_weights, bones)
        relative_m = avatar.position_m.to(dtype) - bones.canonical_root_m.to(dtype)
        position_m = apply(linear, relative_m) + offset_m
        if pose_offset_m is not None:
            position_m = position_m + bones.scale * apply(turning(linear, bones), pose_offset_m.to(dtype))
        return Gaussians(
            position_m=position_m + bones.root_m,
            sigma_m=avatar.sigma_m.to(dtype) * posed_radius_scale(linear, bones.scale),
            opacity=avatar.opacity.to(dtype),
            rgb=avatar.rgb.to(dtype),
        )
