"""Pose features: joint angles looked up in learnable planes and mixed along the kinematic tree. METHOD 4.1.

One plane per bone 6..20 over its normalized (flexion, abduction); one for the five metacarpals over the angles between
palm bones and palm planes. F_i = delta_i for the metacarpals and half the parent's plus half the own beyond, so that
the angles near a joint weigh most: 1/2, 1/4, 1/8, 1/8 at the finger tips.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from jghand_engine.avatar import correctives
from jghand_engine.avatar.correctives import PALM_NEIGHBOR_RANGES_DEG, PALM_PLANE_RANGES_DEG, PLANES
from jghand_engine.hand.kinematics import FRAME_RANGES_DEG
from jghand_engine.learn.frames import HandFrames

# bones 1..5 read the angle between palm bones and the one between palm planes at these places (METHOD 4.1)
_NEIGHBOR_OF_FINGER = (0, 0, 1, 2, 3)
_PLANE_OF_FINGER = (0, 0, 1, 2, 2)


@dataclass(frozen=True)
class Angles:
    """What pose features need to know of the frames of one pose, radians: angles (15, 2) flexion and abduction of bones
    6..20 · palm_p (4,), palm_n (3,): between neighboring palm bones, and palm planes."""

    angles: Tensor
    palm_p: Tensor
    palm_n: Tensor

    @classmethod
    def of(cls, flat: Tensor) -> Angles:
        """From (37,), as `flat_angles` has them."""
        return cls(flat[:30].reshape(15, 2), flat[30:34], flat[34:37])


PoseAngles = HandFrames | Angles


def flat_angles(pose: PoseAngles) -> Tensor:
    """(37,) the angles of a pose in a row."""
    return torch.cat([pose.angles.reshape(-1), pose.palm_p, pose.palm_n])


def normalized(angle_rad: Tensor, range_deg: Tensor) -> Tensor:
    """Angles (..., k) -> -1..1 over their ranges (k, 2); beyond the ends they go on, the lookup clamps."""
    low, high = torch.deg2rad(range_deg.to(angle_rad)).unbind(-1)
    return (angle_rad - low) / (high - low) * 2 - 1


def finger_angles(frames: PoseAngles) -> Tensor:
    """(15, 2) normalized flexion and abduction of bones 6..20 of one pose."""
    return normalized(frames.angles.reshape(-1), torch.from_numpy(FRAME_RANGES_DEG).reshape(-1, 2)).reshape(15, 2)


def palm_angles(frames: PoseAngles) -> Tensor:
    """(5, 2) normalized angles of the metacarpals 1..5 of one pose: between palm bones, and between palm planes."""
    neighbor = normalized(frames.palm_p, torch.tensor(PALM_NEIGHBOR_RANGES_DEG))
    plane = normalized(frames.palm_n, torch.tensor(PALM_PLANE_RANGES_DEG))
    return torch.stack([neighbor[list(_NEIGHBOR_OF_FINGER)], plane[list(_PLANE_OF_FINGER)]], -1)


class AnglePlanes(nn.Module):
    """planes: (16, channels, texels, texels); plane 0 is the metacarpals', 1..15 those of bones 6..20.

    level1: whether the metacarpals have features that depend on the pose; the paper keeps them constant.
    """

    def __init__(self, channels: int, texels: int, *, level1: bool) -> None:
        super().__init__()
        self.level1 = level1
        self.planes = nn.Parameter(torch.zeros(PLANES, channels, texels, texels))

    @classmethod
    def of(cls, plain: correctives.AnglePlanes) -> AnglePlanes:
        """From arrays, without gradients."""
        planes = cls(1, 1, level1=plain.level1)
        planes.planes = nn.Parameter(torch.tensor(plain.planes), requires_grad=False)
        return planes

    def plain(self) -> correctives.AnglePlanes:
        return correctives.AnglePlanes(self.planes.detach().cpu().numpy().copy(), self.level1)

    def forward(self, frames: PoseAngles) -> Tensor:
        """(21, channels) features F_0..F_20 of one pose; F_0 is the mean of the metacarpals'."""
        fingers, palm = finger_angles(frames).to(self.planes.dtype), palm_angles(frames).to(self.planes.dtype)
        level1 = _look_up(self.planes[:1].expand(5, -1, -1, -1), palm if self.level1 else torch.zeros_like(palm))
        own = _look_up(self.planes[1:], fingers).reshape(3, 5, -1)
        levels = [level1]
        for delta in own:
            levels.append(0.5 * (levels[-1] + delta))
        return torch.cat([level1.mean(0, keepdim=True), *levels])


def _look_up(planes: Tensor, at: Tensor) -> Tensor:
    """(B, channels) bilinear value of each plane (B, channels, h, w) at its point (B, 2) in -1..1, clamped."""
    grid = at[:, None, None, :]
    return functional.grid_sample(planes, grid, align_corners=True, padding_mode="border")[:, :, 0, 0]


def octave_of_wave(octaves: tuple[int, int, int]) -> Tensor:
    """(2 sum(octaves),) the octave of each column of `positional_encoding`, to anneal them by."""
    return torch.tensor([octave for count in octaves for octave in range(count) for _ in range(2)])
