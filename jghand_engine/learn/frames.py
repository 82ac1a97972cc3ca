"""Local frames of the bones and the palm, joint angles, and where a hand is degenerate: differentiable, in torch.

Every bone i carries a rotation S_i whose z column is the bone's direction. Metacarpals take their twist from the palm
planes, phalanges from their parent: S_i = S_p(i) Q(u_i), where u_i is the bone's direction in the parent's frame and Q
a swing (METHOD 2.4, 2.5). Everything here concerns a **right** hand; the transform mirrors left hands before.
Inside, the component comes first and the batch last: (3, bones, N), see `rotations`.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from jghand_engine.hand.skeleton import (
    FLEXION_AXIS_MIN,
    FLEXION_CUT,
    PALM_CLAMP,
    PALM_NORMAL_MIN,
    PALM_PRIOR,
    SWING_POLE,
    ZERO_BONE_EPS,
    CanonicalHand,
    FrameFlag,
    Swing,
)
from jghand_engine.learn import rotations as rot


@dataclass(frozen=True)
class HandFrames:
    """Frames of a batch of hands, bones 1..20 (index i - 1), right-hand space.

    S:           (..., 20, 3, 3) columns x, y, z; z along the bone, y the flexion axis, x out of the palm
    S0:          (..., 3, 3) palm frame
    u:           (..., 15, 3) direction of bones 6..20 in the parent's frame
    length:      (..., 20) meters;  direction: (..., 20, 3) unit
    palm_cross:  (..., 4, 3) cross product of neighboring palm bones' directions
    palm_normal: (..., 4, 3) unit normals of the palm planes after the clamp
    flags:       (...) int32, bits of FrameFlag
    """

    S: Tensor
    S0: Tensor
    u: Tensor
    length: Tensor
    direction: Tensor
    palm_cross: Tensor
    palm_normal: Tensor
    flags: Tensor

    @cached_property
    def angles(self) -> Tensor:
        """(..., 15, 2) flexion and abduction of bones 6..20, radians; features, never used to build rotations."""
        with torch.autocast(self.u.device.type, enabled=False):
            ux, uy, uz = self.u.unbind(-1)
            nearness = torch.sqrt((ux * ux + uz * uz).detach())
            ux, uz = rot.damped(ux, nearness), rot.damped(uz, nearness)
            square = ux * ux + uz * uz
            far = square > SWING_POLE**2
            flexion = torch.atan2(torch.where(far, ux, 0.0), torch.where(far, uz, 1.0))
            flexion = torch.where(flexion < FLEXION_CUT, flexion + 2 * math.pi, flexion)
            across = torch.sqrt(torch.where(far, square, SWING_POLE**2))
            return torch.stack([flexion, torch.atan2(-uy, across)], -1)

    @cached_property
    def palm_p(self) -> Tensor:
        """(..., 4) angle between neighboring palm bones (theta^p), radians."""
        with torch.autocast(self.u.device.type, enabled=False):
            threshold = ZERO_BONE_EPS * torch.finfo(self.u.dtype).eps
            normal = self.palm_cross.movedim(-1, 0)
            sine = rot.safe_length(rot.damped(normal, torch.sqrt(rot.dot(normal, normal).detach())), threshold)
            palm = self.direction[..., :5, :].movedim(-1, 0)
            return rot.safe_atan2(sine, rot.dot(palm[..., :-1], palm[..., 1:]), 0.0)

    @cached_property
    def palm_n(self) -> Tensor:
        """(..., 3) signed angle between neighboring palm planes (theta^n), radians."""
        with torch.autocast(self.u.device.type, enabled=False):
            normal = self.palm_normal.movedim(-1, 0)
            first, second = normal[..., :-1], normal[..., 1:]
            shared = self.direction[..., 1:4, :].movedim(-1, 0)
            threshold = ZERO_BONE_EPS * torch.finfo(self.u.dtype).eps
            return rot.safe_atan2(rot.dot(rot.cross(first, second), shared), rot.dot(first, second), threshold)


@dataclass(frozen=True)
class CanonicalTensors:
    """A CanonicalHand (hand.skeleton) for the formulas here: component first and batch last.

    root_m:       (3,)
    joints_m:     (3, 21, 1);  length_m: (20, 1);  direction: (3, 20, 1)
    S:            (3, 3, 20, 1);  S0: (3, 3, 1, 1)
    u:            (3, 15, 1);  swing: (3, 3, 15, 1)
    palm_normal:  (3, 4, 1)
    palm_flip, metacarpal_flip: (3, 3, 1, 1), (3, 3, 5, 1) half turns that replace a minimal rotation at its pole
    """

    root_m: Tensor
    joints_m: Tensor
    length_m: Tensor
    direction: Tensor
    S: Tensor
    S0: Tensor
    u: Tensor
    swing: Tensor
    palm_normal: Tensor
    palm_flip: Tensor
    metacarpal_flip: Tensor

    @classmethod
    def of(cls, hand: CanonicalHand) -> CanonicalTensors:
        """In float64, on the CPU."""

        def turned(array: np.ndarray) -> Tensor:
            return torch.from_numpy(array.T.swapaxes(0, 1) if array.ndim == 3 else array.T).clone().unsqueeze(-1)

        S, S0, swing = turned(hand.frames[1:]), turned(hand.frames[:1]), turned(hand.swing)
        return cls(
            root_m=torch.from_numpy(hand.root_m),
            joints_m=turned(hand.joints_m),
            length_m=turned(hand.length_m),
            direction=turned(hand.direction),
            S=S,
            S0=S0,
            u=turned(hand.u),
            swing=swing,
            palm_normal=turned(hand.palm_normal),
            palm_flip=rot.half_turn(S0[:, 0]),
            metacarpal_flip=rot.half_turn(S[:, 0, :5]),
        )

    def to(self, dtype: torch.dtype, device: torch.device) -> CanonicalTensors:
        """The same hand in another precision or on another device."""
        moved = {field.name: getattr(self, field.name).to(device, dtype) for field in dataclasses.fields(self)}
        return CanonicalTensors(**moved)


def _bones(joints: Tensor) -> Tensor:
    """(3, 21, N) -> (3, 20, N)."""
    return joints[:, 1:] - torch.cat([joints[:, :1].expand(-1, 5, -1), joints[:, 1:16]], 1)


def _palm_vectors(bones: Tensor) -> tuple[Tensor, Tensor]:
    """Sum of the metacarpals index..pinky and the area vector of their fan, (3, 1, N) both, not normalized: each
    counts by how well it is conditioned (METHOD 2.7)."""
    fan = bones[:, 1:5]
    return fan.sum(1, keepdim=True), rot.cross(fan[:, :-1], fan[:, 1:]).sum(1, keepdim=True)


@dataclass(frozen=True)
class ComponentFrames:
    """HandFrames with the component first and the batch last: S (3, 3, 20, N), u (3, 15, N) and so on.

    relative_length (20, N) and size (N): length = relative_length * size.
    """

    S: Tensor
    S0: Tensor
    u: Tensor
    relative_length: Tensor
    size: Tensor
    direction: Tensor
    palm_cross: Tensor
    palm_normal: Tensor
    flags: Tensor

    def batch_first(self, batch: torch.Size) -> HandFrames:
        """The public form with batch shape `batch`; views, no copies."""

        def turned(tensor: Tensor) -> Tensor:
            dims = tensor.dim()
            order = (dims - 1, dims - 2, *range(dims - 2))
            view = tensor.permute(order)
            return view.reshape(*batch, *view.shape[1:])

        return HandFrames(
            S=turned(self.S),
            S0=turned(self.S0).squeeze(-3),
            u=turned(self.u),
            length=turned(self.relative_length * self.size),
            direction=turned(self.direction),
            palm_cross=turned(self.palm_cross),
            palm_normal=turned(self.palm_normal),
            flags=self.flags.reshape(batch),
        )


def hand_size(bones: Tensor) -> Tensor:
    """Largest |component| of any bone, (N,), detached and floored: dividing by it makes every threshold relative, so
    that meters, millimeters and 1e12 behave alike."""
    return bones.detach().abs().amax((0, 1)).clamp_min(torch.finfo(bones.dtype).tiny ** 0.25)


def compute_frames(joints: Tensor, canonical: CanonicalTensors, swing: Swing) -> ComponentFrames:
    """Frames of (3, 21, N) right-hand joints in any unit; canonical in the same dtype and device."""
    bones = _bones(joints)
    size = hand_size(bones)
    relative = bones / size
    threshold = ZERO_BONE_EPS * torch.finfo(joints.dtype).eps
    S0, has_palm = _palm_frame(relative, canonical, threshold)
    palm_from_canonical = rot.mat_mul(S0, canonical.S0.transpose(0, 1))
    fallback = rot.mat_vec(palm_from_canonical, canonical.direction[:, :5])
    palm, palm_good = rot.safe_unit(relative[:, :5], fallback, threshold)
    planes = _palm_planes(palm, palm_from_canonical, canonical)
    frame = _metacarpal_frames(palm, planes.normal, canonical)
    chain = _finger_chains(frame, relative, canonical, swing, threshold)
    flags = (
        FrameFlag.ZERO_BONE * (~(palm_good.all(0) & chain.has_length)).int()
        + FrameFlag.PALM_CLAMPED * planes.clamped.int()
        + FrameFlag.SWING_POLE * (~chain.off_pole).int()
        + FrameFlag.NO_PALM * (~has_palm).int()
    )
    finite = torch.isfinite(joints).all(0).all(0)
    # of a hand that is not finite nothing else can be said
    flags = torch.where(finite, flags, int(FrameFlag.NOT_FINITE))
    return ComponentFrames(
        S=chain.S,
        S0=S0,
        u=chain.u,
        relative_length=rot.safe_length(relative, threshold),
        size=size,
        direction=torch.cat([palm, chain.direction], 1),
        palm_cross=planes.cross,
        palm_normal=planes.normal,
        flags=flags,
    )


def _palm_frame(bones: Tensor, canonical: CanonicalTensors, threshold: float) -> tuple[Tensor, Tensor]:
    """S0 (3, 3, 1, N) and where the palm has a plane (N,). Without one its twist is that of the smallest rotation
    from the canonical palm."""
    axis, area = _palm_vectors(bones)
    canonical_x, canonical_z = canonical.S0[:, 0], canonical.S0[:, 2]
    z, has_axis = rot.safe_unit(axis, canonical_z, threshold)
    x_fallback = rot.mat_vec(rot.minimal_rotation(canonical_z, z, canonical.palm_flip), canonical_x)
    x, has_normal = rot.safe_unit(area - rot.dot(area, z) * z, x_fallback, PALM_NORMAL_MIN)
    return rot.columns(x, rot.cross(z, x), z), (has_axis & has_normal)[0]


@dataclass(frozen=True)
class _PalmPlanes:
    cross: Tensor
    normal: Tensor
    clamped: Tensor


def _palm_planes(palm: Tensor, palm_from_canonical: Tensor, canonical: CanonicalTensors) -> _PalmPlanes:
    """Normals of the four palm planes, drawn to the canonical side by PALM_PRIOR: those of a rigid palm as they are,
    never 0, never flipped (METHOD 2.10)."""
    normal = rot.cross(palm[:, :-1], palm[:, 1:])
    expected = rot.mat_vec(palm_from_canonical, canonical.palm_normal)
    height = rot.dot(normal, expected)
    lifted = normal + (PALM_PRIOR + rot.smooth_floor(height, PALM_CLAMP) - height) * expected
    # along `expected` it is at least PALM_PRIOR long
    unit = lifted * (1 / torch.sqrt(rot.dot(lifted, lifted)))
    return _PalmPlanes(normal, unit, (height < 2 * PALM_CLAMP).any(0))


def _metacarpal_frames(palm: Tensor, normal: Tensor, canonical: CanonicalTensors) -> Tensor:
    """S of bones 1..5, (3, 3, 5, N), from the clamped palm normals."""
    between = 0.5 * (normal[:, 1:3] + normal[:, 2:4])
    finger_normal = torch.cat([normal[:, :2], between, normal[:, 3:]], 1)
    canonical_S = canonical.S[:, :, :5]
    carried = rot.minimal_rotation(canonical.direction[:, :5], palm, canonical.metacarpal_flip)
    y_fallback = rot.mat_vec(carried, canonical_S[:, 1])
    y, _ = rot.safe_unit(rot.cross(palm, finger_normal), y_fallback, FLEXION_AXIS_MIN)
    return rot.columns(rot.cross(y, palm), y, palm)


@dataclass(frozen=True)
class _Chains:
    S: Tensor
    u: Tensor
    direction: Tensor
    has_length: Tensor
    off_pole: Tensor


def _finger_chains(
    metacarpals: Tensor, bones: Tensor, canonical: CanonicalTensors, swing: Swing, threshold: float
) -> _Chains:
    """S of all bones, u and direction of bones 6..20: each phalanx frame is its parent's, turned by the swing."""
    frames, local, directions, has_length, off_pole = [metacarpals], [], [], [], []
    for first in (5, 10, 15):
        parent = frames[-1]
        here = slice(first - 5, first)
        canonical_u = canonical.u[:, here]
        # a bone without length keeps its canonical angle to the parent
        direction, good = rot.safe_unit(bones[:, first : first + 5], rot.mat_vec(parent, canonical_u), threshold)
        # normalized again: stops the drift of round-off along the chain
        u, _ = rot.safe_unit(rot.transposed_mat_vec(parent, direction), canonical_u, threshold, full_at=0.0)
        Q, away = swing_of(u, canonical, here, swing)
        frames.append(rot.mat_mul(parent, Q))
        local.append(u)
        directions.append(direction)
        has_length.append(good)
        off_pole.append(away)
    return _Chains(
        S=torch.cat(frames, 2),
        u=torch.cat(local, 1),
        direction=torch.cat(directions, 1),
        has_length=torch.cat(has_length).all(0),
        off_pole=torch.cat(off_pole).all(0),
    )


def swing_of(u: Tensor, canonical: CanonicalTensors, bones: slice, swing: Swing) -> tuple[Tensor, Tensor]:
    """Q (3, 3, k, N) of local directions u (3, k, N) of the phalanges `bones` (0..15), and where it is off the pole."""
    if swing is Swing.EULER:
        return rot.swing_euler(u)
    return rot.swing_minimal(u, canonical.swing[:, :, bones])
