"""What a trained avatar knows beyond its canonical Gaussians: normals, light, correctives, the look of its shadow."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch

from jghand_engine.avatar.cast_shadow import CastShadow
from jghand_engine.avatar.correctives import Correctives, PoseNet
from jghand_engine.avatar.light import Light
from jghand_engine.avatar.tiers import Baked, CachedNet, Price, Tier, choose
from jghand_engine.limits import SHADOW_GAIN, SHADOW_TINT, SHADOW_UNSEEN


@dataclass(frozen=True)
class ShadowLook:
    """How dark the self-shadow is: gain and strength per color channel of METHOD 5.2, both learned.

    seen: 0..1, the most that it changes a channel of any pixel, as `jghand bake` measured it; None: not measured
    """

    gain: float = SHADOW_GAIN
    tint: tuple[float, float, float] = SHADOW_TINT
    seen: float | None = None

    @property
    def is_seen(self) -> bool:
        """Whether anybody would miss it."""
        return self.seen is None or self.seen > SHADOW_UNSEEN


@dataclass(frozen=True)
class Ellipsoid:
    """How canonical Gaussians differ from spheres of their sigma.

    log_stretch: (N, 3) logarithm of each axis over sigma · quaternion: (N, 4) wxyz of any length, turns the axes
    """

    log_stretch: torch.Tensor
    quaternion: torch.Tensor

    def prefix(self, count: int) -> Ellipsoid:
        """The same for the first `count` Gaussians."""
        return Ellipsoid(self.log_stretch[:count], self.quaternion[:count])


@dataclass(frozen=True)
class Learned:
    """normal: (N, 3) float32 unit, canonical frame, outward · shine: (N,) float32, 0 and up, how much is reflected
    light: of the capture, in the world's frame · correctives: None when the pose changes nothing but the bones
    shadow: its look, None when it was trained without · world_offsets: offsets are in world axes, as the paper prints
    it, instead of turning with the hand (METHOD 2.9) · ellipsoid: of Gaussians that are no spheres, else None
    cast: shadows that its parts cast on each other, None when it was trained without
    baked: cheaper tiers of the correctives, and what they cost; None where nothing was measured
    """

    normal: torch.Tensor
    shine: torch.Tensor
    light: Light
    correctives: Correctives | None
    shadow: ShadowLook | None
    world_offsets: bool = False
    ellipsoid: Ellipsoid | None = None
    cast: CastShadow | None = None
    baked: Baked | None = None

    def with_tier(self, wanted: Tier) -> tuple[Learned, Price | None]:
        """The same with the correctives of a tier, and its price where it has one. InputError for a tier without."""
        net = self.correctives
        if not isinstance(net, PoseNet):
            return self, None
        price = choose(self.baked, wanted)
        if price is None or price.tier is Tier.EXACT or self.baked is None:
            return self, price
        cheaper = self.baked.linear if price.tier is Tier.LINEAR else CachedNet(net)
        return replace(self, correctives=cheaper), price

    def prefix(self, count: int) -> Learned:
        """The same for the first `count` Gaussians."""
        return replace(
            self,
            normal=self.normal[:count],
            shine=self.shine[:count],
            correctives=None if self.correctives is None else self.correctives.prefix(count),
            ellipsoid=None if self.ellipsoid is None else self.ellipsoid.prefix(count),
            cast=None if self.cast is None else self.cast.prefix(count),
            baked=None if self.baked is None else self.baked.prefix(count),
        )
