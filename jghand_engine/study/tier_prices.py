"""What a tier of an avatar's correctives costs: time of a frame, size, accuracy; for `jghand distill`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import Correctives, LinearCorrectives, PoseNetwork
from jghand_engine.avatar.learned_storage import pack_learned
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import LOST_MAX_DB, Distilled, Price, Tier
from jghand_engine.errors import InputError
from jghand_engine.render.settings import RenderSettings
from jghand_engine.study.frame_time import Subject, frame_case
from jghand_engine.study.tier_yardsticks import Yardstick
from jghand_engine.study.timing import measure

FRAME_ROUNDS, WARM_UP = 30, 3


@dataclass(frozen=True)
class Offer:
    """A tier that could be kept: its price, and the linear correctives where it is one."""

    price: Price
    linear: LinearCorrectives | None = None


def pose_net_of(avatar: HandAvatar) -> PoseNetwork:
    """The network of a trained avatar. InputError for an avatar that has none."""
    net = None if avatar.learned is None else avatar.learned.correctives
    if not isinstance(net, PoseNetwork):
        wanted = "correctives that depend on the pose"
        raise InputError(f"avatar {avatar.info.name}", wanted=wanted, came="none", remedy="Give a trained avatar.")
    return net


def price_tiers(avatar: HandAvatar, linear: Mapping[int, LinearCorrectives], yard: Yardstick) -> list[Offer]:
    """Prices of the exact tier and all linear ones."""
    net = pose_net_of(avatar)
    kinds: list[tuple[Tier, int, Correctives]] = [(Tier.EXACT, 0, net)]
    kinds += [(Tier.LINEAR, basis, correctives) for basis, correctives in sorted(linear.items())]
    variants = [with_correctives(avatar, correctives) for _, _, correctives in kinds]
    frame_ms = _frame_ms(variants, yard.subject(avatar))
    exact_db = yard.psnr_db(variants[0])
    offers = []
    for (tier, basis, correctives), variant, ms in zip(kinds, variants, frame_ms, strict=True):
        psnr_db = exact_db if tier is Tier.EXACT else yard.psnr_db(variant)
        kept = correctives if isinstance(correctives, LinearCorrectives) else None
        megabytes = _megabytes(avatar, kept)
        offers.append(Offer(Price(tier, basis, ms, megabytes, psnr_db, yard.lost_db(exact_db, psnr_db)), kept))
    return offers


def best_linear(offers: Sequence[Offer]) -> Offer | None:
    """The linear tier to keep: the smallest that loses little enough, else the most accurate."""
    linear = [offer for offer in offers if offer.linear is not None]
    good = [offer for offer in linear if offer.price.lost_db <= LOST_MAX_DB]
    if good:
        return min(good, key=lambda offer: offer.price.basis)
    return min(linear, key=lambda offer: offer.price.lost_db, default=None)


def distilled(avatar: HandAvatar, offers: Sequence[Offer], measured_on: str) -> HandAvatar:
    """The avatar with its prices and one linear tier."""
    kept = best_linear(offers)
    prices = tuple(offer.price for offer in offers if offer.linear is None or offer is kept)
    tiers = Distilled(None if kept is None else kept.linear, prices, measured_on)
    return replace(avatar, learned=replace(avatar.learned, distilled=tiers)) if avatar.learned is not None else avatar


def with_correctives(avatar: HandAvatar, correctives: Correctives) -> HandAvatar:
    """The avatar with other correctives, for drawing."""
    if avatar.learned is None:
        return avatar
    return replace(avatar, learned=replace(avatar.learned, correctives=correctives, distilled=None))


# ---- time and size ---------------------------------------------------------------------------------------------------


def _frame_ms(variants: Sequence[HandAvatar], subject: Subject) -> list[float]:
    """Median milliseconds of whole frames of preset `viewport`, nothing reused; the variants take turns."""
    settings = RenderSettings(reuse=False)
    cases = [frame_case(replace(subject, avatar=variant), settings, str(n)) for n, variant in enumerate(variants)]
    measured = measure(cases, rounds=FRAME_ROUNDS, warm_up=WARM_UP)
    return [next(one.median_ms for one in measured if one.section == str(n)) for n in range(len(variants))]


def _megabytes(avatar: HandAvatar, linear: LinearCorrectives | None) -> float:
    """What a tier adds to a compact file, 1e6 bytes: the network or its arrays."""
    if avatar.learned is None:
        return 0.0
    learned = replace(avatar.learned, distilled=None if linear is None else Distilled(linear, (), ""))
    mine = "linear." if linear is not None else "pose_net."
    packed = pack_learned(learned, Storage.COMPACT)
    return sum(array.nbytes for name, array in packed.items() if name.startswith(mine)) / 1e6
