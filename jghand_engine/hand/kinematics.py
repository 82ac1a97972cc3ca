"""A hand as joint angles and back: decomposition, forward kinematics, interpolation between poses. METHOD 6.3.

A pose is the palm's frame and place, the directions of the metacarpals inside the palm, two angles for each
phalanx and the bone lengths. All functions are batched, differentiable torch; right-hand space inside, either hand at
the border.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from jghand_engine.errors import InputError
from jghand_engine.hand import rotations as rot
from jghand_engine.hand.frames import metacarpal_frames, swing_of
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.transform import JointTransform


@dataclass(frozen=True)
class HandPose:
    """A hand in joint angles; right-hand space (a left hand is mirrored first).

    root_m: (..., 3) wrist · palm: (..., 3, 3) frame S0 · metacarpal: (..., 5, 3) directions inside the palm frame
    angles: (..., 15, 2) flexion and abduction of bones 6..20, radians, in the frames of the transform's swing
    length_m: (..., 20) bone lengths
    """

    root_m: Tensor
    palm: Tensor
    metacarpal: Tensor
    angles: Tensor
    length_m: Tensor


def decompose(transform: JointTransform, joints_m: Tensor) -> HandPose:
    """(..., 21, 3) joints -> HandPose; `forward_kinematics` gives the joints back.

    A bone without length keeps its canonical angle; a palm without plane its canonical twist (METHOD 2.10).
    """
    frames = transform.frames(joints_m)
    ux, uy, uz = frames.u.unbind(-1)
    # not frames.angles: those flatten the flexion near the abduction pole, and here the way back must be exact
    flexion = rot.safe_atan2(ux, uz, 0.0)
    abduction = rot.safe_atan2(-uy, rot.safe_length(torch.stack([ux, uz]), 0.0), 0.0)
    palm_directions = frames.direction[..., :5, :]
    return HandPose(
        root_m=_mirrored(transform, joints_m[..., 0, :]),
        palm=frames.S0,
        metacarpal=(frames.S0.transpose(-1, -2).unsqueeze(-3) * palm_directions.unsqueeze(-2)).sum(-1),
        angles=torch.stack([flexion, abduction], -1),
        length_m=frames.length,
    )


def local_directions(angles: Tensor) -> Tensor:
    """(2, *rest) flexion and abduction -> (3, *rest) unit directions u(theta) in the parent's frame. METHOD 2.4."""
    flexion, abduction = angles
    across = torch.cos(abduction)
    return torch.stack([torch.sin(flexion) * across, -torch.sin(abduction), torch.cos(flexion) * across])


def forward_kinematics(transform: JointTransform, pose: HandPose) -> Tensor:
    """HandPose -> (..., 21, 3) joints, meters: b_i = l_i S_p(i) u_i, S_i = S_p(i) Q(u_i)."""
    batch = pose.root_m.shape[:-1]
    palm = pose.palm.reshape(-1, 3, 3).permute(1, 2, 0).unsqueeze(2)
    inside = pose.metacarpal.reshape(-1, 5, 3).permute(2, 1, 0)
    u = local_directions(pose.angles.reshape(-1, 15, 2).permute(2, 1, 0))
    length = pose.length_m.reshape(-1, 20).T
    canonical = transform.canonical_hand(u.dtype, u.device)
    metacarpals = rot.mat_vec(palm, inside)
    frame = metacarpal_frames(metacarpals, palm, canonical)
    starts = [pose.root_m.reshape(-1, 3).T.unsqueeze(1)]
    starts.append(starts[0] + length[:5] * metacarpals)
    for first in (0, 5, 10):
        here = slice(first, first + 5)
        starts.append(starts[-1] + length[first + 5 : first + 10] * rot.mat_vec(frame, u[:, here]))
        frame = rot.mat_mul(frame, swing_of(u[:, here], canonical, here, transform.swing)[0])
    joints = torch.cat(starts, 1).permute(2, 1, 0).reshape(*batch, 21, 3)
    return _mirrored(transform, joints)


def interpolate(transform: JointTransform, first_m: Tensor, second_m: Tensor, parts: Tensor) -> Tensor:
    """Hands between two poses by joint angles: (..., 21, 3) and (..., 21, 3) at parts (T,) -> (T, ..., 21, 3).

    Angles, bone lengths and the wrist go linearly, the angles the short way round; metacarpals are slerped inside
    the palm frame and the palm frame itself along its shortest turn. Exact at parts 0 and 1.
    """
    if first_m.shape != second_m.shape:
        raise InputError("second pose", wanted=f"shape {tuple(first_m.shape)}", came=str(tuple(second_m.shape)))
    a, b = decompose(transform, first_m), decompose(transform, second_m)
    parts = torch.as_tensor(parts, dtype=first_m.dtype, device=first_m.device).reshape(-1)

    def share(dims: int) -> Tensor:
        return parts.reshape(-1, *[1] * dims)

    def linear(x: Tensor, y: Tensor) -> Tensor:
        part = share(x.dim())
        return (1 - part) * x + part * y

    turn = b.angles - a.angles
    short = turn - 2 * math.pi * torch.round(turn / (2 * math.pi))
    angles = a.angles + share(a.angles.dim()) * short
    metacarpal = rot.slerp(
        a.metacarpal.movedim(-1, 0).unsqueeze(1),
        b.metacarpal.movedim(-1, 0).unsqueeze(1),
        share(a.metacarpal.dim() - 1),
    )
    palm = rot.slerp_rotation(
        a.palm.movedim((-2, -1), (0, 1)).unsqueeze(2),
        b.palm.movedim((-2, -1), (0, 1)).unsqueeze(2),
        share(a.palm.dim() - 2),
    )
    pose = HandPose(
        root_m=linear(a.root_m, b.root_m),
        palm=palm.movedim((0, 1), (-2, -1)),
        metacarpal=metacarpal.movedim(0, -1),
        angles=angles,
        length_m=linear(a.length_m, b.length_m),
    )
    return forward_kinematics(transform, pose)


def _mirrored(transform: JointTransform, points: Tensor) -> Tensor:
    """(..., 3) points with x negated for a left hand."""
    if transform.handedness is Handedness.RIGHT:
        return points
    return points * points.new_tensor([-1.0, 1.0, 1.0])
