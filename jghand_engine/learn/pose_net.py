"""What the pose changes on the skin beyond skinning: offsets and shade of every Gaussian, from the joint angles.

METHOD 4.1: a small network reads where a Gaussian sits (positional encoding of u, v, d) and the angles of the joints
near it (pose features, mixed by its skin weights). Differentiable; `correctives.py` has its plain
numbers.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor, nn
from torch.nn import functional

from jghand_engine.avatar.correctives import (
    SHADE_MAX,
    LinearCorrectives,
    PoseNetShape,
    PoseNetwork,
    positional_encoding,
    products,
)
from jghand_engine.learn.pose_features import AnglePlanes, PoseAngles


@dataclass(frozen=True)
class Correction:
    """offset_m: (N, 3) in canonical axes, added after skinning · shade: (N, 3) logarithm of a factor of the color."""

    offset_m: Tensor
    shade: Tensor


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
        encoding = torch.from_numpy(positional_encoding(uvd.numpy(), shape.octaves))
        self.register_buffer("_constant", torch.cat([encoding, bone_weights], -1), persistent=False)

    @classmethod
    def of(cls, network: PoseNetwork, bone_weights: Tensor, uvd: Tensor) -> PoseNet:
        """A finished one, without gradients."""
        with torch.random.fork_rng(devices=[]):  # a new network draws random numbers: nobody else should notice
            net = cls(bone_weights, uvd, network.shape).requires_grad_(False)
        net.load_state_dict({name: torch.tensor(array) for name, array in network.weights.items()})
        return net

    def plain(self) -> PoseNetwork:
        """The numbers of now, apart from what goes on learning."""
        state = self.state_dict().items()
        return PoseNetwork(self.shape, {name: tensor.detach().cpu().numpy().copy() for name, tensor in state})

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

    def part(self, rows: slice | Tensor) -> PoseNet:
        """The same network for some of the Gaussians; parameters are shared."""
        other = PoseNet.__new__(PoseNet)
        nn.Module.__init__(other)
        other.shape = self.shape
        for name in ("angles", "encoding_in", "angles_in", "middle", "out"):
            setattr(other, name, getattr(self, name))
        other.register_buffer("_constant", self._constant[rows], persistent=False)  # type: ignore[index]
        return other

    @property
    def bone_weights(self) -> Tensor:
        """(N, 21) by which the features of the bones are mixed."""
        return self._constant[:, self.encoding_in.in_features :]  # type: ignore[index]


@dataclass(frozen=True)
class LinearNet:
    """See correctives.LinearCorrectives. bone_weights: (N, 21) W."""

    angles: AnglePlanes
    mean: Tensor
    projection: Tensor
    bone_weights: Tensor
    constant: Tensor
    direction: Tensor
    scale: Tensor

    @classmethod
    def of(cls, linear: LinearCorrectives, bone_weights: Tensor, uvd: Tensor) -> LinearNet:
        """As tensors."""
        names = ("mean", "projection", "constant", "direction", "scale")
        tensors = {name: torch.tensor(getattr(linear, name)) for name in names}
        return cls(AnglePlanes.of(linear.angles), bone_weights=bone_weights, **tensors)

    @cached_property
    def _directions(self) -> Tensor:
        """(N, K, 6) float32."""
        return self.direction.float() * self.scale.repeat_interleave(3, 1)[:, None]

    def numbers(self, frames: PoseAngles) -> Tensor:
        """(21, K) of the bones of one pose."""
        return numbers_of(self.angles(frames), self.mean, self.projection, self.direction.shape[1])

    def __call__(self, frames: PoseAngles) -> Correction:
        """Of all Gaussians."""
        mixed = self.bone_weights @ self.numbers(frames)
        both = self.constant + torch.bmm(mixed[:, None], self._directions)[:, 0]
        return Correction(both[:, :3], both[:, 3:])


def numbers_of(features: Tensor, mean: Tensor, projection: Tensor, basis: int) -> Tensor:
    """(21, basis) of features (21, C): projections, then products of two of them, those of the first ones first."""
    simple = (features - mean) @ projection
    first, second = products(simple.shape[-1], basis)
    return torch.cat([simple[..., :basis], simple[..., first] * simple[..., second]], -1)
