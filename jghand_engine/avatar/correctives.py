"""What the pose changes on the skin beyond skinning: offsets and shade of every Gaussian, from the joint angles.

METHOD 4.1: a small network reads where a Gaussian sits (positional encoding of u, v, d) and the angles of the joints
near it (pose features, mixed by its skin weights). This is the exact form; `tiers.py` has the cheaper ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional

from jghand_engine.avatar.pose_features import AnglePlanes, PoseAngles, positional_encoding
from jghand_engine.limits import SHADE_MAX


@dataclass(frozen=True)
class Correction:
    """offset_m: (N, 3) in canonical axes, added after skinning · shade: (N, 3) logarithm of a factor of the color."""

    offset_m: Tensor
    shade: Tensor


class Correctives(Protocol):
    """Gives the correction of one pose for all Gaussians of an avatar."""

    def __call__(self, frames: PoseAngles) -> Correction: ...

    def prefix(self, count: int) -> Correctives:
        """The same for the first `count` Gaussians."""
        ...


@dataclass(frozen=True)
class PoseNetShape:
    """octaves: of the encoding of u, v, d · angle_channels, angle_texels: of the angle planes · hidden: width of the
    two hidden layers · level1: whether metacarpals have features · reach_m: longest offset along an axis, meters ·
    shaded: whether the shade is predicted too"""

    octaves: tuple[int, int, int] = (6, 6, 4)
    angle_channels: int = 16
    angle_texels: int = 16
    hidden: int = 128
    level1: bool = True
    reach_m: float = 0.010
    shaded: bool = True


class PoseNet(nn.Module):
    """The network. bone_weights: (N, 21) · uvd: (N, 3) of the canonical Gaussians.

    The first layer sees [encoding | W F]: W F A is (W)(F A), so encoding and weights are one constant matrix, whose
    gradient nobody needs, and only the small F A changes with the pose.
    """

    def __init__(self, bone_weights: Tensor, uvd: Tensor, shape: PoseNetShape) -> None:
        super().__init__()
        self.shape = shape
        self.angles = AnglePlanes(shape.angle_channels, shape.angle_texels, level1=shape.level1)
        waves = 2 * sum(shape.octaves)
        self.encoding_in = nn.Linear(waves, shape.hidden)
        self.angles_in = nn.Linear(shape.angle_channels, shape.hidden, bias=False)
        self.middle = nn.Linear(shape.hidden, shape.hidden)
        self.out = nn.Linear(shape.hidden, 6 if shape.shaded else 3)
        constant = torch.cat([positional_encoding(uvd.double(), shape.octaves).float(), bone_weights], -1)
        self.register_buffer("_constant", constant, persistent=False)

    def forward(self, frames: PoseAngles, count: int | None = None, wave_weight: Tensor | None = None) -> Correction:
        """Of the first `count` Gaussians. wave_weight: (waves,) 0..1, by which the encoding is annealed."""
        constant: Tensor = self._constant[:count]  # type: ignore[index]
        encoding = self.encoding_in.weight if wave_weight is None else self.encoding_in.weight * wave_weight
        first = torch.cat([encoding, self.angles_in(self.angles(frames)).T], 1)
        hidden = functional.relu(functional.linear(constant, first, self.encoding_in.bias))
        return self.finish(hidden)

    def finish(self, hidden: Tensor) -> Correction:
        """From the first hidden layer (N, hidden), after its ReLU, to the correction."""
        out = self.out(functional.relu(self.middle(hidden)))
        offset_m = self.shape.reach_m * torch.tanh(out[:, :3])
        shade = SHADE_MAX * torch.tanh(out[:, 3:6]) if self.shape.shaded else torch.zeros_like(offset_m)
        return Correction(offset_m, shade)

    def prefix(self, count: int) -> PoseNet:
        """The same network for the first `count` Gaussians; parameters are shared."""
        return self.part(slice(count))

    def part(self, rows: slice) -> PoseNet:
        """The same network for some of the Gaussians; parameters are shared."""
        other = PoseNet.__new__(PoseNet)
        nn.Module.__init__(other)
        other.shape = self.shape
        for name in ("angles", "encoding_in", "angles_in", "middle", "out"):
            setattr(other, name, getattr(self, name))
        other.register_buffer("_constant", self._constant[rows], persistent=False)  # type: ignore[index]
        return other

    @property
    def encoding(self) -> Tensor:
        """(N, waves) the positional encoding of the Gaussians."""
        return self._constant[:, : self.encoding_in.in_features]  # type: ignore[index]

    @property
    def bone_weights(self) -> Tensor:
        """(N, 21) by which the features of the bones are mixed."""
        return self._constant[:, self.encoding_in.in_features :]  # type: ignore[index]
