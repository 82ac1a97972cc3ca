"""The usual way from joints to skin and its usual formulas, to set ours against. They are no choices for use.

Written from descriptions (METHOD 2.2, 2.10), not from anybody's code, as hand models of the literature do it: local
frames from normalized cross products, angles by the arc cosine of a clipped dot product, directions divided by
"length + 1e-8", absolute coordinates in the working precision, one rigid frame for the palm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.native import contract

# the usual guards of these formulas: "length + eps", clipped arc cosine
EPS = 1e-8
CLIP = 1e-6


@dataclass(frozen=True)
class UsualBones:
    """What skinning needs (learn.skinning.PoseTransforms), absolute: roots are zero. angles: (..., 15, 2) radians"""

    linear: Tensor
    offset_m: Tensor
    root_m: Tensor
    canonical_root_m: Tensor
    scale: Tensor
    angles: Tensor


def usual_unit(vector: Tensor) -> Tensor:
    """v / (|v| + 1e-8), (..., 3)."""
    return vector / (vector.norm(dim=-1, keepdim=True) + EPS)


def usual_angle(a: Tensor, b: Tensor) -> Tensor:
    """Angle between unit vectors (..., 3) by acos of the clipped dot product, radians."""
    return torch.acos(((a * b).sum(-1)).clamp(-1 + CLIP, 1 - CLIP))


class UsualTransform:
    """Joints (..., 21, 3) -> UsualBones, in the joints' own precision. crossed: phalanges take their frame from the
    cross product with their parent, as keypoint rigs do, instead of flexion and abduction angles, as HALO does."""

    def __init__(
        self, canonical_joints_m: Tensor | np.ndarray, *, handedness: Handedness, crossed: bool = False
    ) -> None:
        self._sign = torch.tensor([-1.0 if handedness is Handedness.LEFT else 1.0, 1.0, 1.0], dtype=torch.float64)
        self._crossed = crossed
        self._joints_m = torch.as_tensor(canonical_joints_m, dtype=torch.float64)
        self._frames, self._lengths, _ = self._local(self._joints_m)

    def bones(self, joints_m: Tensor) -> UsualBones:
        dtype, sign = joints_m.dtype, self._sign.to(joints_m.dtype)
        frames, lengths, angles = self._local(joints_m * sign)
        canonical = self._joints_m.to(dtype)
        stretch = lengths / self._lengths.to(dtype)
        turn = frames @ self._frames.to(dtype).transpose(-1, -2)
        linear = stretch[..., None, None] * turn
        palm = stretch.mean(-1)[..., None, None] * turn[..., 2, :, :]
        linear = torch.cat([palm.unsqueeze(-3), linear], -3)
        starts = [0, *PARENTS[1:]]
        offset_m = (joints_m * sign)[..., starts, :] - (linear @ canonical[starts, :, None])[..., 0]
        none = torch.zeros(3, dtype=dtype)
        mirrored = sign[:, None] * linear
        return UsualBones(mirrored, offset_m * sign, none, none, stretch.mean(-1), angles)

    def frames(self, joints_m: Tensor) -> Tensor:
        """(..., 20, 3, 3) of bones 1..20."""
        return self._local(joints_m)[0]

    def _local(self, joints_m: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Frames (..., 20, 3, 3), lengths (..., 20), angles (..., 15, 2)."""
        bones = joints_m[..., 1:, :] - joints_m[..., list(PARENTS[1:]), :]
        along = usual_unit(bones)
        normals = usual_unit(torch.linalg.cross(along[..., :4, :], along[..., 1:5, :]))
        between = 0.5 * (normals[..., 1:3, :] + normals[..., 2:4, :])
        normals = torch.cat([normals[..., :2, :], between, normals[..., 3:, :]], -2)
        y = usual_unit(torch.linalg.cross(along[..., :5, :], normals))
        frames = [torch.stack([torch.linalg.cross(y, along[..., :5, :]), y, along[..., :5, :]], -1)]
        angles = []
        for first in (5, 10, 15):
            parent, child = frames[-1], along[..., first : first + 5, :]
            if self._crossed:  # the axis is the cross product of the bone with its parent
                y = usual_unit(torch.linalg.cross(parent[..., 2], child))
                turned = torch.stack([torch.linalg.cross(y, child), y, child], -1)
                angle = torch.stack([usual_angle(parent[..., 2], child), torch.zeros_like(child[..., 0])], -1)
            else:
                turned, angle = _by_angles(parent, child)
            frames.append(turned)
            angles.append(angle)
        return torch.cat(frames, -3), bones.norm(dim=-1), torch.cat(angles, -2)


def _by_angles(parent: Tensor, child: Tensor) -> tuple[Tensor, Tensor]:
    """Frame of a phalanx: its parent's, turned by flexion and abduction, which are measured by arc cosines."""
    u = (parent.transpose(-1, -2) @ child.unsqueeze(-1))[..., 0]
    o, i = torch.zeros_like(u[..., 0]), torch.ones_like(u[..., 0])
    shadow = usual_unit(torch.stack([u[..., 0], o, u[..., 2]], -1))
    flexion = torch.sign(u[..., 0]) * usual_angle(shadow, torch.stack([o, o, i], -1))
    abduction = -torch.sign(u[..., 1]) * usual_angle(u, shadow)
    cf, sf, ca, sa = flexion.cos(), flexion.sin(), abduction.cos(), abduction.sin()
    Q = torch.stack([cf, sf * sa, sf * ca, o, ca, -sa, -sf, cf * sa, cf * ca], -1).unflatten(-1, (3, 3))
    return parent @ Q, torch.stack([flexion, abduction], -1)


def usual_ink(covariance_px2: Tensor, offsets_px: Tensor, opacity: float) -> Tensor:
    """Alpha (P,) of a Gaussian at offsets (P, 2) from its center, from the inverse of its covariance xx, xy, yy (3,):
    the blur is added, the determinant is a c - b^2, in the working precision."""
    a, b, c = covariance_px2 + contract.BLUR_PX2 * torch.tensor([1.0, 0.0, 1.0], dtype=covariance_px2.dtype)
    det = a * c - b * b
    x, y = offsets_px.to(covariance_px2.dtype).unbind(-1)
    return opacity * torch.exp(-0.5 * (c * x * x - 2 * b * x * y + a * y * y) / det)
