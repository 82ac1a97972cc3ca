"""How good an avatar is on pictures that it did not learn from: every metric of every picture, and their means.

Avatars are drawn by the renderer that users have (`render.renderer`), with settings that are said beside the figures.
A mean over pictures is the mean of their values, decibels included, as the papers do it.
"""

from __future__ import annotations

import itertools
import time
import zlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache
from typing import Any, TypeAlias, TypeVar

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.scene_light import SceneLight
from jghand_engine.captures.captures import Capture
from jghand_engine.captures.known_light import MixedPicture, load_groups, mix, random_weights
from jghand_engine.captures.sample import Sample, TrainingImage, image_digest, load_image
from jghand_engine.captures.splits import Split
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.learn.crops import CropScore, crop_groups, crop_means, crop_scores
from jghand_engine.learn.metrics import compare, mask_box
from jghand_engine.learn.perceptual import PerceptualMetric, distances
from jghand_engine.render.blur import Hand
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import SceneRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.template.builtin import load_template

Item = TypeVar("Item")

# figures are given apart for pictures whose fingers are bent, on the mean of their joints, below, between and above
# these angles, degrees: an open, a relaxed, a half closed hand and a fist
FLEXION_REGIONS_DEG = (15.0, 35.0, 60.0)
# whatever draws a hand, an avatar in the renderer or a model that is still learning: a pose, or (21, 3) level-order
# joints, world, meters -> (H, W, 4) float32, premultiplied, display-referred sRGB
Picturer: TypeAlias = Callable[[Hand, Handedness, Camera], np.ndarray]


class AvatarPicturer:
    """Draws `avatar` with the renderer that users have, of hands as large as they were learned."""

    def __init__(self, avatar: HandAvatar, settings: RenderSettings) -> None:
        self._avatar, self._settings = avatar, replace(settings, antialias=False)
        self._renderers: dict[tuple[Handedness, bool], SceneRenderer] = {}

    def __call__(self, hand: Hand, handedness: Handedness, camera: Camera) -> np.ndarray:
        return self._rgba(hand, handedness, camera, None)

    def in_light(self, sample: Sample, light: SceneLight) -> np.ndarray:
        """(H, W, 4) float32, premultiplied, scene-linear: the hand of a sample in a light."""
        return self._rgba(sample.hand, sample.handedness, sample.camera, light)

    def _rgba(self, hand: Hand, handedness: Handedness, camera: Camera, light: SceneLight | None) -> np.ndarray:
        key = handedness, light is not None
        if key not in self._renderers:
            self._renderers[key] = SceneRenderer([self._avatar.for_hand(handedness)], self._settings, light)
        self._renderers[key].light = light
        return self._renderers[key].render([hand], camera).rgba


def pictured(
    sample: Sample, draw: Picturer, truth: MixedPicture | TrainingImage | None = None
) -> tuple[np.ndarray, TrainingImage, float]:
    """A sample as it is drawn (H, W, 4), as it is, and the milliseconds of drawing it. truth: `truth_of` it, where it
    is drawn more than once.

    A picture of known light is drawn in it, in `judged_mix`, and both are exposed alike before sRGB's curve.
    """
    truth = truth_of(sample, draw) if truth is None else truth
    started = time.perf_counter()
    if isinstance(truth, TrainingImage):
        rgba = draw(sample.hand, sample.handedness, sample.camera)
        return rgba, truth, 1e3 * (time.perf_counter() - started)
    assert isinstance(draw, AvatarPicturer)
    rgba = draw.in_light(sample, truth.light)
    render_ms = 1e3 * (time.perf_counter() - started)
    ours = linear_to_srgb(np.clip(truth.exposure * rgba[..., :3], 0, 1))
    return np.concatenate([ours, rgba[..., 3:]], -1), _exposed(truth), render_ms


def truth_of(sample: Sample, draw: Picturer) -> MixedPicture | TrainingImage:
    """What a sample looks like, as far as who draws it can be lit. InputError as `load_groups`, `load_image`."""
    return load_image(sample) if sample.light is None or not isinstance(draw, AvatarPicturer) else judged_mix(sample)


def _exposed(one: MixedPicture) -> TrainingImage:
    return TrainingImage(linear_to_srgb(np.clip(one.exposure * one.rgb, 0, 1)), one.alpha)


def judged_mix(sample: Sample) -> MixedPicture:
    """The mix of the lights of a picture by which hands are judged. InputError as `load_groups`."""
    picture = load_groups(sample)
    if picture.light.judged_in is not None:
        return mix(picture, np.repeat(np.array(picture.light.judged_in)[:, None], 3, 1))
    seed = zlib.crc32(f"{sample.sequence}/{sample.frame}/{sample.camera_name}".encode())
    return mix(picture, random_weights(picture.light, np.random.default_rng(seed)))


@dataclass(frozen=True)
class PictureScore:
    """One picture.

    category:    how it was held out, or "learnt"
    flexion_deg: mean flexion of the joints of index..pinky
    scores:      by metric and region, such as psnr_box
    render_ms:   drawing it, files excluded
    crops:       close up, where that was asked for
    """

    sample: Sample
    category: str
    flexion_deg: float
    scores: Mapping[str, float]
    render_ms: float
    crops: tuple[CropScore, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        sample = self.sample
        where = {"sequence": sample.sequence, "frame": sample.frame, "camera": sample.camera_name}
        return where | {
            "category": self.category, "flexion_deg": self.flexion_deg, "render_ms": self.render_ms, **self.scores,
            **({"crops": [asdict(crop) for crop in self.crops]} if self.crops else {}),
        }  # fmt: skip


@dataclass(frozen=True)
class Evaluation:
    """Figures of one avatar on pictures of one capture. name: of the avatar; origin: of the split; ceiling: crops of
    the same pictures made again, with other noise."""

    name: str
    capture: str
    origin: str
    pictures: tuple[PictureScore, ...]
    ceiling: tuple[CropScore, ...] = ()

    def crops(self) -> dict[str, tuple[CropScore, ...]]:
        """Crops of all pictures and of the ceiling by category, kind and scale."""
        return crop_groups([*(crop for picture in self.pictures for crop in picture.crops), *self.ceiling])

    def groups(self) -> dict[str, tuple[PictureScore, ...]]:
        """The pictures of each category, and all of them where there is more than one category."""
        names = dict.fromkeys(picture.category for picture in self.pictures)
        groups = {name: tuple(p for p in self.pictures if p.category == name) for name in names}
        return groups if len(groups) == 1 else groups | {"all": self.pictures}

    def regions(self) -> dict[str, tuple[PictureScore, ...]]:
        """The pictures by how far the fingers are bent, those regions that there are."""
        edges = (-np.inf, *FLEXION_REGIONS_DEG, np.inf)
        groups = {}
        for low, high in itertools.pairwise(edges):
            inside = tuple(p for p in self.pictures if low <= p.flexion_deg < high)
            if inside:
                groups[_region_name(low, high)] = inside
        return groups

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON: means of every group, and every picture."""
        by_flexion = {f"fingers {name}": group for name, group in self.regions().items()}
        groups = {**self.groups(), "all": self.pictures, **by_flexion}
        return {
            "avatar": self.name,
            "capture": self.capture,
            "split": self.origin,
            "means": {name: {"pictures": len(group), **means(group)} for name, group in groups.items()},
            "crops": {name: {"crops": len(group), **crop_means(group)} for name, group in self.crops().items()},
            "pictures": [picture.as_dict() for picture in self.pictures],
        }


def _region_name(low: float, high: float) -> str:
    if np.isinf(low):
        return f"bent below {high:g}°"
    return f"bent {low:g}° and more" if np.isinf(high) else f"bent {low:g}° to {high:g}°"


def means(pictures: Sequence[PictureScore]) -> dict[str, float]:
    """Mean of every metric that all of the pictures have."""
    shared = [name for name in pictures[0].scores if all(name in picture.scores for picture in pictures)]
    return {name: float(np.mean([picture.scores[name] for picture in pictures])) for name in shared}


def categories_of(split: Split, which: str, limit: int = 0) -> dict[str, tuple[Sample, ...]]:
    """The pictures to measure, by category. which: 'test', 'train' or 'all'.

    limit: at most so many of each category, spread evenly over it; 0: all. InputError where there are none.
    """
    groups = split.categories() if which in ("test", "all") else {}
    if which in ("train", "all") and split.train:
        groups = groups | {"learnt": split.train}
    if not groups:
        raise InputError(f"pictures of the {which} split", wanted="at least one", came=f"none ({split.origin})",
                         remedy="Hold out poses or cameras, or take another --split.")  # fmt: skip
    return {name: spread(samples, limit) for name, samples in groups.items()}


def spread(items: Sequence[Item], limit: int) -> tuple[Item, ...]:
    """At most `limit` of the items, evenly over their order; 0: all."""
    if not 0 < limit < len(items):
        return tuple(items)
    return tuple(items[place] for place in np.linspace(0, len(items) - 1, limit).round().astype(int))


def measure_pictures(
    categories: Mapping[str, Iterable[Sample]],
    draw: Picturer,
    *,
    perceptual: Sequence[PerceptualMetric] = (),
    crops: bool = False,
    tick: Callable[[], None] = lambda: None,
) -> tuple[PictureScore, ...]:
    """Draws and measures every sample, crops too where asked for. tick: called after each. Errors of files and renderer
    pass through."""
    pictures = []
    for category, samples in categories.items():
        for sample in samples:
            pictures.append(_measure(sample, category, draw, perceptual, crops))
            tick()
    return tuple(pictures)


def _measure(
    sample: Sample, category: str, draw: Picturer, perceptual: Sequence[PerceptualMetric], crops: bool
) -> PictureScore:
    rgba, truth, render_ms = pictured(sample, draw)
    # premultiplied: over black it is the picture
    scores = compare(rgba[..., :3], truth.rgb, truth.mask)
    box = mask_box(truth.mask)
    for region, cut in (("full", lambda picture: picture), ("box", box.of)):
        far = distances(perceptual, cut(rgba[..., :3]), cut(truth.rgb))
        scores |= {f"{name}_{region}": value for name, value in far.items()}
    close = crop_scores(sample, category, rgba[..., :3], truth, perceptual) if crops else ()
    flexion_deg = finger_flexion_deg(sample.joints_m, sample.handedness)
    return PictureScore(sample, category, flexion_deg, scores, render_ms, close)


def ceiling_crops(
    samples: Iterable[Sample], again: Capture, perceptual: Sequence[PerceptualMetric] = ()
) -> tuple[CropScore, ...]:
    """Crops of those samples that `again` has too, made with other noise, against each other: no avatar can do better.

    InputError where it has none of them, shows other joints, or is the same to the bit.
    """
    theirs = {(one.pose, one.camera_name): one for one in again.samples}
    both = [(one, theirs[key]) for one in samples if (key := (one.pose, one.camera_name)) in theirs]
    remedy = "Make the same capture again with more --samples and another --out."
    if not both or any(not np.allclose(one.joints_m, two.joints_m, atol=1e-5) for one, two in both):
        came = "other poses" if both else "none of those that are measured"
        raise InputError(f"pictures of {again.name}", wanted="the same hand, poses and cameras", came=came,
                         remedy=remedy)  # fmt: skip
    crops: list[CropScore] = []
    for one, two in both:
        truth, second = (load_image(s) if s.light is None else _exposed(judged_mix(s)) for s in (one, two))
        if np.array_equal(truth.rgb, second.rgb):
            raise InputError(f"pictures of {again.name}", wanted="other noise", came="the same pictures to the bit",
                             remedy=remedy)  # fmt: skip
        crops += crop_scores(one, "ceiling", second.rgb, truth, perceptual)
    return tuple(crops)


def finger_flexion_deg(joints_m: np.ndarray, handedness: Handedness) -> float:
    """Mean flexion of the three joints of index..pinky, degrees: about 0 for a flat hand, 85 for a fist."""
    angles = _skeleton(handedness).bones(joints_m).phalanx_angles_rad
    return float(np.degrees(angles[:, 0].reshape(3, 5)[:, 1:].mean()))


@cache
def _skeleton(handedness: Handedness) -> Skeleton:
    return Skeleton(load_template().joints_m, handedness=handedness)


ALL_LEARNED = "all of these pictures were learned from"
NOT_KNOWN = "whether they were held out is not known"


@dataclass(frozen=True)
class HeldOut:
    """split: as it was for this avatar; its origin says what is not certain · warning: a sentence for the user, empty
    when the avatar was learned from split.train and nothing else of the capture · is_known: whether it is known what
    the avatar was learned from."""

    split: Split
    warning: str = ""
    is_known: bool = True


def held_out(avatar: HandAvatar, capture: Capture, split: Split) -> HeldOut:
    """split: of the pictures of `capture`, as a training with the same choice of pictures would have it."""
    if avatar.learned is None:
        return HeldOut(split)
    told = avatar.info.learned_from
    if not split.train:
        return _not_known(split, "There are no pictures to learn from beside those that are measured")
    if told is None:
        return _not_known(split, "The avatar does not say which pictures it was learned from")
    if told.digest == image_digest(split.train):
        return HeldOut(split)
    if told.digest in (image_digest(split.all_learned().train), image_digest(capture.samples)):
        warning = f"The avatar was learned from all pictures of {capture.name}: its figures say nothing of new ones."
        return HeldOut(replace(split.all_learned(), origin=ALL_LEARNED), warning)
    came = f"{told.pictures} pictures of {told.capture} ({told.split})"
    return _not_known(split, f"The avatar was learned from {came}, which is another choice than the one here")


def _not_known(split: Split, why: str) -> HeldOut:
    warning = f"{why}: whether the pictures it is measured on were among them is not known."
    return HeldOut(replace(split, origin=f"{split.origin}; {NOT_KNOWN}"), warning, is_known=False)
