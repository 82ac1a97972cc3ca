"""Cheaper ways to the corrections of a pose, each at a price that was measured and is written into the avatar.

    exact    the network, every frame
    linear   K numbers of every bone, mixed by the skin weights like the pose features they are made of, times K
             directions of every Gaussian: what the network does around the poses it was distilled on

A tier without a price is not used: whoever trades accuracy for time has to see the rate first (RENDERING 5).
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from jghand_engine.avatar.correctives import LinearCorrectives, PerGaussian
from jghand_engine.errors import InputError

# what a tier may lose to be taken unasked, dB (RENDERING 5)
LOST_MAX_DB = 0.1
# ... and how much of the exact tier's frame it may take: what is saved is to be more than what two medians of one thing
# differ by on a busy machine, some percent
FASTER_MAX = 0.9


class Tier(StrEnum):
    """auto takes the linear one where it loses at most LOST_MAX_DB and its frame takes at most FASTER_MAX of the exact
    one's; else the exact one."""

    AUTO = "auto"
    EXACT = "exact"
    LINEAR = "linear"


@dataclass(frozen=True)
class Price:
    """What a tier costs.

    tier:      EXACT or LINEAR
    basis:     K of a linear one, else 0
    frame_ms:  median of a whole frame, on the machine where it was measured
    megabytes: what it adds to the file
    psnr_db:   accuracy
    lost_db:   how much of the exact tier's accuracy it loses
    """

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
class Distilled(PerGaussian):
    """What `jghand distill` adds to an avatar.

    linear:      None when no such tier is kept
    prices:      of all its tiers
    measured_on: in words, what the prices are of
    """

    PARTS = ("linear",)

    linear: LinearCorrectives | None
    prices: tuple[Price, ...]
    measured_on: str


def choose(distilled: Distilled | None, wanted: Tier) -> Price | None:
    """The price of the tier to use; None for the exact one where nothing was measured.

    InputError for a tier that has no price.
    """
    prices = () if distilled is None else distilled.prices
    if wanted is Tier.AUTO:
        exact, linear = _priced(prices, Tier.EXACT), _priced(prices, Tier.LINEAR)
        if linear is None or linear.lost_db > LOST_MAX_DB:
            return exact
        faster = exact is None or linear.frame_ms <= FASTER_MAX * exact.frame_ms
        return linear if faster else exact
    price = _priced(prices, wanted)
    if price is None and wanted is not Tier.EXACT:
        priced = [str(Tier.AUTO), str(Tier.EXACT), *(str(price.tier) for price in prices)]
        raise InputError(
            "tier of the correctives",
            wanted=" | ".join(dict.fromkeys(priced)),
            came=wanted,
            remedy="`jghand distill` measures what a tier costs, and writes it into the avatar.",
        )
    return price


def _priced(prices: tuple[Price, ...], tier: Tier) -> Price | None:
    return next((price for price in prices if price.tier is tier), None)
