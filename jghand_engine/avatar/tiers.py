"""Cheaper ways to the corrections of a pose, each at a price that was measured and is written into the avatar.

    exact    the network, every frame
    cached   the network, but what its first layer makes of a Gaussian's place is computed once: equal but for rounding.
             The compiled skin (`fast_correctives.py`) always does so, and there the two are one
    linear   K numbers of every bone, mixed by the skin weights like the pose features they are made of, times K
             directions of every Gaussian: what the network does around the poses it was distilled on (`distill.py`)

A tier without a price is not used: whoever trades accuracy for time has to see the rate first (RENDERING 5).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum
from functools import cached_property

import torch
from torch import Tensor
from torch.nn import functional

from jghand_engine.avatar.correctives import Correction, PoseNet, PoseNetShape
from jghand_engine.avatar.pose_features import AnglePlanes, PoseAngles
from jghand_engine.errors import InputError
from jghand_engine.limits import TIER_FASTER_MAX, TIER_LOST_MAX_DB


class Tier(StrEnum):
    """auto takes the linear one where it loses at most TIER_LOST_MAX_DB and its frame takes at most TIER_FASTER_MAX of
    the exact one's; else the exact one. The cached one is what compiled code does for the exact one anyway."""

    AUTO = "auto"
    EXACT = "exact"
    CACHED = "cached"
    LINEAR = "linear"


@dataclass(frozen=True)
class Price:
    """tier: EXACT, CACHED or LINEAR · basis: K of a linear one, else 0 · frame_ms: median of a whole frame, on the
    machine where it was measured · megabytes: what it adds to the file · psnr_db: accuracy · lost_db: how much of the
    exact tier's accuracy it loses"""

    tier: Tier
    basis: int
    frame_ms: float
    megabytes: float
    psnr_db: float
    lost_db: float

    @property
    def name(self) -> str:
        """`linear-8`"""
        return f"{self.tier}-{self.basis}" if self.basis else str(self.tier)


@dataclass(frozen=True)
class Baked:
    """What `jghand bake` adds to an avatar. linear: None when no such tier is kept · prices: of all its tiers ·
    measured_on: in words, what the prices are of"""

    linear: LinearCorrectives | None
    prices: tuple[Price, ...]
    measured_on: str

    def prefix(self, count: int) -> Baked:
        """The same for the first `count` Gaussians."""
        return replace(self, linear=None if self.linear is None else self.linear.prefix(count))


class CachedNet:
    """The network with its first layer's view of the Gaussians computed once."""

    def __init__(self, net: PoseNet) -> None:
        self.net = net
        with torch.no_grad():
            self._places = functional.linear(net.encoding, net.encoding_in.weight, net.encoding_in.bias)

    def __call__(self, frames: PoseAngles) -> Correction:
        """See Correctives."""
        net = self.net
        from_angles = net.angles_in(net.angles(frames))
        return net.finish(functional.relu(torch.addmm(self._places, net.bone_weights, from_angles)))

    def prefix(self, count: int) -> CachedNet:
        """See Correctives."""
        return CachedNet(self.net.prefix(count))


@dataclass(frozen=True)
class LinearCorrectives:
    """correction = constant + sum_k c_k(x) direction_k,   c(x) = sum_i W_i(x) numbers(F_i)

    angles: the network's planes, which give the features F_i of the bones · mean (C,), projection (C, P): the first P
    numbers of a bone are (F_i - mean) @ projection; further ones are products of two of these
    bone_weights: (N, 21) W · constant: (N, 6), of offset in meters and shade, each a float16
    direction: (N, K, 6) int8, in units of scale: (N, 2) float32, of offset and shade
    """

    angles: AnglePlanes
    mean: Tensor
    projection: Tensor
    bone_weights: Tensor
    constant: Tensor
    direction: Tensor
    scale: Tensor

    @property
    def basis(self) -> int:
        """K."""
        return self.direction.shape[1]

    @cached_property
    def _directions(self) -> Tensor:
        """(N, K, 6) float32."""
        return self.direction.float() * self.scale.repeat_interleave(3, 1)[:, None]

    def longest_offset_m(self) -> float:
        """What no offset exceeds along an axis, in any pose: features are means of the planes' texels."""
        texels = self.angles.planes.detach().movedim(1, -1).flatten(0, -2)
        largest = ((texels - self.mean) @ self.projection).abs().amax(0)
        numbers = numbers_of(largest, torch.zeros_like(largest), torch.eye(len(largest)).to(largest), self.basis)
        return float((self.constant[:, :3].abs() + numbers @ self._directions[..., :3].abs()).max())

    def numbers(self, frames: PoseAngles) -> Tensor:
        """(21, K) of the bones of one pose."""
        return numbers_of(self.angles(frames), self.mean, self.projection, self.basis)

    def __call__(self, frames: PoseAngles) -> Correction:
        """See Correctives."""
        mixed = self.bone_weights @ self.numbers(frames)
        both = self.constant + torch.bmm(mixed[:, None], self._directions)[:, 0]
        return Correction(both[:, :3], both[:, 3:])

    def prefix(self, count: int) -> LinearCorrectives:
        """See Correctives."""
        names = ("bone_weights", "constant", "direction", "scale")
        return replace(self, **{name: getattr(self, name)[:count] for name in names})


def numbers_of(features: Tensor, mean: Tensor, projection: Tensor, basis: int) -> Tensor:
    """(21, basis) of features (21, C): projections, then products of two of them, those of the first ones first."""
    linear = (features - mean) @ projection
    columns = list(linear.unbind(-1))[:basis]
    for second in range(projection.shape[1]):
        for first in range(second + 1):
            if len(columns) < basis:
                columns.append(columns[first] * columns[second])
    return torch.stack(columns, -1)


def basis_most(shape: PoseNetShape) -> int:
    """The largest basis that the features of a network give: themselves, and products of two."""
    channels = shape.angle_channels
    return channels + channels * (channels + 1) // 2


def choose(baked: Baked | None, wanted: Tier) -> Price | None:
    """The price of the tier to use; None for the exact one where nothing was measured.

    InputError for a tier that has no price.
    """
    prices = () if baked is None else baked.prices
    if wanted is Tier.AUTO:
        exact, linear = _priced(prices, Tier.EXACT), _priced(prices, Tier.LINEAR)
        if linear is None or linear.lost_db > TIER_LOST_MAX_DB:
            return exact
        faster = exact is None or linear.frame_ms <= TIER_FASTER_MAX * exact.frame_ms
        return linear if faster else exact
    price = _priced(prices, wanted)
    if price is None and wanted is not Tier.EXACT:
        priced = [str(Tier.AUTO), str(Tier.EXACT), *(str(price.tier) for price in prices)]
        raise InputError(
            "tier of the correctives",
            wanted=" | ".join(dict.fromkeys(priced)),
            came=wanted,
            remedy="`jghand bake` measures what a tier costs, and writes it into the avatar.",
        )
    return price


def _priced(prices: tuple[Price, ...], tier: Tier) -> Price | None:
    return next((price for price in prices if price.tier is tier), None)
