"""The bones of a hand whose lengths are sought: joint angles and bone lengths to joints, in torch.

It is `track.poses.JointChain`, whose bones cannot change, with bones that can and a palm whose first joints can move.
The hand as a whole keeps its length: one camera cannot tell a small hand from a far one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.track.poses import JointChain

# within the four angles of a finger: flexion of its three bones, and abduction of the first
_FLEXIONS, _ABDUCTION = (0, 2, 3), 1
# of the bones 1..20, at their places from 0: those of the palm, and the middle finger's
_PALM, _MIDDLE = 5, 2


@dataclass(frozen=True)
class Chain:
    """See JointChain; right hand, wrist at the origin.

    palm_m: (6, 3) · bones_m: (3, 5, 3) · flexion_axes: (3, 5, 3) · abduction_axes: (5, 3)
    length_m: wrist to middle tip along the bones, whatever their lengths
    """

    palm_m: Tensor
    bones_m: Tensor
    flexion_axes: Tensor
    abduction_axes: Tensor
    length_m: float

    @classmethod
    def of(
        cls, canonical_joints_m: np.ndarray, length_m: float | None = None, dtype: torch.dtype = torch.float32
    ) -> Chain:
        """Of a canonical right hand, (21, 3) level order, meters. length_m: None for that hand's own"""
        chain = JointChain.of(canonical_joints_m)
        palm, bones, flexion, abduction = (
            torch.tensor(array, dtype=dtype)
            for array in (chain.palm_m, chain.bones_m, chain.flexion_axes, chain.abduction_axes)
        )
        length = hand_length(canonical_joints_m) if length_m is None else length_m
        return cls(palm, bones, flexion, abduction, float(length))

    def joints(self, angle_rad: Tensor, log_length: Tensor, palm_shift_m: Tensor) -> Tensor:
        """(F, 21, 3) level order, meters.

        angle_rad: (F, 20) finger by finger · log_length: (20,) of the bones, against this hand's, before the whole is
        brought to `length_m` · palm_shift_m: (5, 3) of the first joints, in the palm
        """
        longer = log_length.exp()
        palm = self.palm_m[1:] * longer[:_PALM, None] + palm_shift_m
        bones = self.bones_m * longer[_PALM:].reshape(3, 5, 1)
        scale = self.length_m / (palm[_MIDDLE].norm() + bones[:, _MIDDLE].norm(dim=-1).sum())
        palm, bones = palm * scale, bones * scale
        angle = angle_rad.reshape(-1, 5, 4)
        levels = [palm.new_zeros(len(angle), 1, 3), palm.expand(len(angle), 5, 3)]
        turn = rotation(self.abduction_axes * angle[..., _ABDUCTION, None])
        for joint, which in enumerate(_FLEXIONS):
            turn = turn @ rotation(self.flexion_axes[joint] * angle[..., which, None])
            levels.append(levels[-1] + (turn @ bones[joint][..., None])[..., 0])
        return torch.cat(levels, 1)


def chain_of(canonical_joints_m: np.ndarray, own_joints_m: np.ndarray) -> JointChain:
    """A canonical hand's chain with another one's palm and bone lengths, which is what a fit with that canonical hand
    found: its axes stay. Both (21, 3) level order, meters."""
    chain = JointChain.of(canonical_joints_m)
    longer = (bone_lengths(own_joints_m) / bone_lengths(canonical_joints_m))[_PALM:].reshape(3, 5, 1)
    return replace(chain, palm_m=own_joints_m[:6] - own_joints_m[0], bones_m=chain.bones_m * longer)


def rotation(vector_rad: Tensor) -> Tensor:
    """(..., 3, 3) rotations of rotation vectors (..., 3), differentiable at 0 too."""
    # below this length both factors are 1 in any precision
    angle = (vector_rad * vector_rad).sum(-1, keepdim=True).clamp_min(1e-16).sqrt()[..., None] / torch.pi
    x, y, z = vector_rad.unbind(-1)
    zero = torch.zeros_like(x)
    cross = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).unflatten(-1, (3, 3))
    one = torch.eye(3, dtype=vector_rad.dtype)
    return one + torch.sinc(angle) * cross + torch.sinc(angle / 2) ** 2 / 2 * (cross @ cross)
