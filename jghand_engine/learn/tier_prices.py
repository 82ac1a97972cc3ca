"""What a tier of an avatar's correctives costs: time of a frame, size, accuracy; for `jghand distill`.

Accuracy is that on held-out pictures, or, without pictures, how near a tier comes to the exact one.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.correctives import Correctives, LinearCorrectives, PoseNetwork
from jghand_engine.avatar.learned_storage import pack_learned
from jghand_engine.avatar.pose_range import trained_range
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import LOST_MAX_DB, Distilled, Price, Tier
from jghand_engine.captures.captures import Capture
from jghand_engine.captures.splits import Split
from jghand_engine.color import decibels
from jghand_engine.errors import InputError
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.hand.shapes import pose_names
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.evaluate import AvatarPicturer, categories_of, means, measure_pictures
from jghand_engine.learn.pose_features import flat_angles
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, preset
from jghand_engine.render.subject import Subject, moving_subject
from jghand_engine.render.timing import frame_case, measure

FRAME_ROUNDS, WARM_UP = 30, 3
# accuracy of the paper's avatars (RENDERING 9.1): what an error beside it costs is said of a model as good as this, dB
MODEL_PSNR_DB = 33.4
# pictures are drawn as `jghand evaluate` draws them
PRESET = "final"
# pixels of the pictures of made-up poses; of the frames of their motion one of so many is a pose
SIZE_PX = (512, 334)
POSE_STEP = 8
# how much the poses that the avatar is said to know vary around the named ones, degrees
KNOWN_VARIATION_DEG = 6.0


@dataclass(frozen=True)
class Measure:
    """What the tiers of an avatar are measured by."""

    # in words, for the avatar's description
    on: str
    # (P, 37) angles of poses that the avatar knows, near which the tiers are fitted
    known_poses: Tensor
    # a motion before a camera, for times
    subject: Subject
    # how near the pictures of a variant of the avatar come, dB
    psnr_db: Callable[[HandAvatar], float]
    # what a tier loses, dB: of the exact tier's accuracy and its own
    lost_db: Callable[[float, float], float]


def held_out_measure(avatar: HandAvatar, capture: Capture, split: Split, limit: int, doubt: str = "") -> Measure:
    """By pictures of a capture that were held out. limit: of each kind, at most; 0: all · doubt: told of them where the
    avatar may have learned from them

    Pictures of learned poses are left out where there are others: tiers are fitted to these poses, which would flatter
    them.
    """
    unseen = replace(split, novel_view=()) if split.novel_pose or split.novel_both else split
    categories = categories_of(unseen, "test", limit)
    counts = ", ".join(f"{len(samples)} of {kind}" for kind, samples in categories.items())
    on = f"held-out pictures of {capture.name} ({counts}), preset {PRESET}{f'; {doubt}' if doubt else ''}"
    hand = avatar.for_hand(capture.handedness)
    learned = {sample.pose: sample.joints_m for sample in split.train}

    def psnr_db(variant: HandAvatar) -> float:
        """Mean over whole pictures, over black."""
        return means(measure_pictures(categories, AvatarPicturer(variant, preset(PRESET))))["psnr_full"]

    subject = Subject(capture.name, hand, capture.joints_m(), capture.samples[0].camera)
    known = flat_poses(hand, np.stack(list(learned.values())))
    return Measure(on, known, subject, psnr_db, lambda exact_db, tier_db: exact_db - tier_db)


def exact_tier_measure(exact: HandAvatar) -> Measure:
    """By the exact tier's own pictures of named poses and those between them."""
    subject = moving_subject(exact.info.name, exact, *SIZE_PX)
    poses_m = subject.poses[::POSE_STEP]

    def pictures(avatar: HandAvatar) -> list[np.ndarray]:
        renderer = HandRenderer(avatar, preset(PRESET))
        return [np.clip(renderer.render(pose_m, subject.camera).rgba[..., :3], 0, 1) for pose_m in poses_m]

    wanted: list[np.ndarray] = []

    def psnr_db(avatar: HandAvatar) -> float:
        """Of all pictures together."""
        if not wanted:
            wanted.extend(pictures(exact))
        pairs = zip(pictures(avatar), wanted, strict=True)
        return decibels(float(np.mean([np.square(ours - theirs).mean() for ours, theirs in pairs])))

    on = f"{len(poses_m)} made-up poses against the exact tier, preset {PRESET}"
    of = f"lost of an avatar of {MODEL_PSNR_DB:g} dB"
    return Measure(f"{on}; {of}", known_poses(exact), subject, psnr_db, lost_of_a_model_db)


def known_poses(avatar: HandAvatar) -> Tensor:
    """(P, 37) angles that the avatar is said to know: of another motion than the one that is measured, kept inside the
    angles that were trained."""
    options = MotionOptions(hold_s=0.0, variation_deg=KNOWN_VARIATION_DEG, seed=1)
    motion = pose_sequence_of_names(
        pose_names(), avatar.canonical_joints_m, handedness=avatar.handedness, options=options
    )
    poses = flat_poses(avatar, motion.joints_m[::POSE_STEP])
    limits_rad = trained_range(avatar.info)
    if limits_rad is not None:
        low, high = torch.from_numpy(limits_rad).float().reshape(2, 30)
        poses[:, :30] = torch.minimum(torch.maximum(poses[:, :30], low), high)
    return poses


def flat_poses(avatar: HandAvatar, joints_m: np.ndarray) -> Tensor:
    """(P, 37) float32 angles of joints (P, 21, 3)."""
    transform = transform_of(avatar)
    return torch.stack([flat_angles(transform.frames(torch.from_numpy(each.copy()))) for each in joints_m]).float()


def lost_of_a_model_db(exact_db: float, tier_db: float) -> float:
    """What an avatar of MODEL_PSNR_DB loses when the independent error of a tier is added (RENDERING 9.1)."""
    return 0.0 if tier_db >= exact_db else 10 * math.log10(1 + 10 ** ((MODEL_PSNR_DB - tier_db) / 10))


# ---- prices ----------------------------------------------------------------------------------------------------------


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


def price_tiers(avatar: HandAvatar, linear: Mapping[int, LinearCorrectives], by: Measure) -> list[Offer]:
    """Prices of the exact tier and all linear ones."""
    kinds: list[tuple[Tier, int, Correctives]] = [(Tier.EXACT, 0, pose_net_of(avatar))]
    kinds += [(Tier.LINEAR, basis, correctives) for basis, correctives in sorted(linear.items())]
    variants = [with_correctives(avatar, correctives) for _, _, correctives in kinds]
    frame_ms = _frame_ms(variants, by.subject)
    exact_db = by.psnr_db(variants[0])
    offers = []
    for (tier, basis, correctives), variant, ms in zip(kinds, variants, frame_ms, strict=True):
        psnr_db = exact_db if tier is Tier.EXACT else by.psnr_db(variant)
        kept = correctives if isinstance(correctives, LinearCorrectives) else None
        price = Price(tier, basis, ms, _megabytes(avatar, kept), psnr_db, by.lost_db(exact_db, psnr_db))
        offers.append(Offer(price, kept))
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
