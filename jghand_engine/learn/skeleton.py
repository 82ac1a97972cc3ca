"""The differentiable form of `hand.skeleton`: what training differentiates, and what tests compare the kernel with.

The formulas are those of `hand.skeleton`; METHOD 2.6 to 2.10.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.pose_range import angle_name
from jghand_engine.errors import InputError
from jghand_engine.hand.canonical import CanonicalHand
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import check_joint_shape
from jghand_engine.hand.skeleton import SCALE_RATIO_MIN, ScaleMode, Swing, scale_exponent
from jghand_engine.hand.wrist import Wrist
from jghand_engine.learn import rotations as rot
from jghand_engine.learn.frames import CanonicalTensors, ComponentFrames, HandFrames, compute_frames


@dataclass(frozen=True)
class BoneTransforms:
    """The maps B_0..B_20 of a batch of hands, root-relative on both sides:

        x_posed_m - root_m = linear @ (x_m - canonical_root_m) + offset_m

    Add `root_m` last: a hand far from the origin then loses nothing before it. For a left hand the matrices act on
    the right-hand template. Of a hand whose forearm is turned the changes of its slices follow, see `Wrist`.

    linear: (..., 21, 3, 3) · offset_m: (..., 21, 3) · root_m: (..., 3) · canonical_root_m: (3,)
    scale: (...) scale of the whole hand, s_g · frames: frames and flags, in right-hand space
    """

    linear: Tensor
    offset_m: Tensor
    root_m: Tensor
    canonical_root_m: Tensor
    scale: Tensor
    frames: HandFrames

    def matrices(self) -> Tensor:
        """(..., 21, 3, 4) matrices canonical -> posed in whole coordinates, meters."""
        carried = (self.linear * self.canonical_root_m).sum(-1)
        offset = self.offset_m - carried + self.root_m.unsqueeze(-2)
        return torch.cat([self.linear, offset.unsqueeze(-1)], -1)


class JointTransform:
    """Computes BoneTransforms from joints, against one canonical right hand.

    canonical_joints_m: (21, 3) level order, right hand, meters; validated (METHOD 2.4)
    handedness:         of the joints that `bones` will get; left ones are mirrored, the canonical hand stays right
    swing:              'minimal' or 'euler', see Swing
    scale_mode:         'axial', 'uniform' or the exponent between, see scale_exponent
    forearm_way:        (3,) of the canonical hand, from the wrist along its forearm; None for a hand without one
    InputError for an unusable canonical hand or an unknown option.
    """

    def __init__(
        self,
        canonical_joints_m: np.ndarray,
        *,
        handedness: Handedness,
        swing: str = Swing.MINIMAL,
        scale_mode: ScaleMode = "axial",
        forearm_way: np.ndarray | None = None,
    ) -> None:
        self.handedness = Handedness(handedness)
        self.swing = Swing(swing)
        self.exponent = scale_exponent(scale_mode)
        canonical = CanonicalHand.build(canonical_joints_m)
        self._wrist = None if forearm_way is None else Wrist(canonical.frames[0], forearm_way)
        self.canonical = CanonicalTensors.of(canonical)
        self._casts: dict[tuple[torch.dtype, torch.device], CanonicalTensors] = {}

    def bones(self, joints_m: Tensor, forearm: np.ndarray | None = None) -> BoneTransforms:
        """(..., 21, 3) level-order joints -> BoneTransforms with the same batch shape.

        forearm: (4,) its turn, see `HandPose`, of one hand without a batch; of a hand without one it counts for
        nothing. No gradient goes through what it changes.

        Differentiable; float64 stays float64, half precision is computed in float32, autocast is switched off inside.
        A hand with a non-finite joint gets NaN matrices and the flag NOT_FINITE; others are not touched by it.
        InputError for another shape or an integer dtype.
        """
        check_joint_shape(joints_m)
        if not joints_m.is_floating_point():
            raise InputError("joints", wanted="a floating point tensor", came=str(joints_m.dtype))
        if joints_m.dtype in (torch.float16, torch.bfloat16):
            joints_m = joints_m.float()
        with torch.autocast(joints_m.device.type, enabled=False):
            batch = joints_m.shape[:-2]
            joints = joints_m.reshape(-1, *joints_m.shape[-2:]).permute(2, 1, 0)
            bones = self._component_first(self._mirrored(joints.contiguous()), batch)
        if self._wrist is None or forearm is None:
            return bones
        changes = self._wrist.changes(bones.linear[0].detach().double().cpu().numpy(), forearm)
        linear, offset_m = (torch.from_numpy(part).to(bones.linear) for part in (changes[..., :3], changes[..., 3]))
        return replace(bones, linear=torch.cat([bones.linear, linear]), offset_m=torch.cat([bones.offset_m, offset_m]))

    def frames(self, joints_m: Tensor) -> HandFrames:
        """(..., 21, 3) joints -> their frames alone."""
        return self.bones(joints_m).frames

    def canonical_hand(self, dtype: torch.dtype, device: torch.device) -> CanonicalTensors:
        """The canonical hand in a precision and on a device; kept for the next call."""
        key = (dtype, device)
        if key not in self._casts:
            self._casts[key] = self.canonical.to(dtype, device)
        return self._casts[key]

    def maps(
        self, joints: Tensor, frames: ComponentFrames, canonical: CanonicalTensors
    ) -> tuple[Tensor, Tensor, Tensor]:
        """What another transform than this one changes; right-hand space, component first, root-centered.

        joints (3, 21, N) and their frames -> linear parts (3, 3, 21, N), where the bones meet (3, 21, N): here on the
        joints, and the scale of the whole hand (N,).
        """
        linear, scale = _linear_parts(frames, canonical, self.exponent)
        return linear, joints, scale

    def _mirrored(self, vectors: Tensor) -> Tensor:
        """(3, ...) with x negated for a left hand."""
        if self.handedness is Handedness.RIGHT:
            return vectors
        return torch.cat([-vectors[:1], vectors[1:]])

    def _component_first(self, joints: Tensor, batch: torch.Size) -> BoneTransforms:
        canonical = self.canonical_hand(joints.dtype, joints.device)
        frames = compute_frames(joints, canonical, self.swing)
        root = joints[:, :1]
        linear, placed, scale = self.maps(joints - root, frames, canonical)
        offset = _offsets(linear, _pivots(placed), canonical)
        linear, offset, root = self._mirrored(linear), self._mirrored(offset), self._mirrored(root)
        return BoneTransforms(
            linear=linear.permute(3, 2, 0, 1).reshape(*batch, 21, 3, 3),
            offset_m=offset.permute(2, 1, 0).reshape(*batch, 21, 3),
            root_m=root[:, 0].T.reshape(*batch, 3),
            canonical_root_m=canonical.root_m,
            scale=scale.reshape(batch),
            frames=frames.batch_first(batch),
        )


def _pivots(joints: Tensor) -> Tensor:
    """(3, 21, N) root-centered joints -> where the bone of each matrix starts: the wrist for B_0..B_5, then parents."""
    return torch.cat([joints[:, :1].expand(-1, 6, -1), joints[:, 1:16]], 1)


def _offsets(linear: Tensor, pivot: Tensor, canonical: CanonicalTensors) -> Tensor:
    """j_p - L j^c_p (3, 21, N). In double: the difference of two large numbers is where float32 joints lose most."""
    carried = rot.mat_vec(linear.double(), _pivots(canonical.joints_m).double())
    return (pivot.double() - carried).to(linear.dtype)


def _linear_parts(frames: ComponentFrames, canonical: CanonicalTensors, exponent: float) -> tuple[Tensor, Tensor]:
    """L_0..L_20 (3, 3, 21, N) and s_g (N,)."""
    relative = frames.relative_length / canonical.length_m
    relative_scale = frames.relative_length.sum(0) / canonical.length_m.sum(0)
    along, whole = relative * frames.size, relative_scale * frames.size
    if exponent == 0.0:
        radial = whole.expand_as(along)
    elif exponent == 1.0:
        radial = along
    else:
        tiny = torch.finfo(along.dtype).tiny
        ratio = (relative / relative_scale.clamp_min(tiny)).clamp_min(SCALE_RATIO_MIN)
        radial = whole * ratio**exponent
    turn = rot.mat_mul(frames.S, canonical.S.transpose(0, 1))
    # the axial part uses the measured direction, not the turned canonical one: no round-off of the chain in the joints
    axial = along * frames.direction - radial * rot.mat_vec(turn, canonical.direction)
    bones = radial * turn + rot.outer(axial, canonical.direction)
    palm = whole * rot.mat_mul(frames.S0, canonical.S0.transpose(0, 1))
    return torch.cat([palm, bones], 2), whole


def angle_ranges(transform: JointTransform, joints_m: Tensor) -> dict[str, tuple[float, float]]:
    """Least and greatest flexion and abduction of every joint that bends, radians, by "joint flexion"."""
    angles = transform.bones(joints_m).frames.angles
    low, high = angles.amin(0), angles.amax(0)
    return {
        angle_name(bone, kind): (float(low[bone - 6, kind]), float(high[bone - 6, kind]))
        for bone in range(6, 21)
        for kind in (0, 1)
    }
