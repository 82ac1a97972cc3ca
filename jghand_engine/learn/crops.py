"""What eyes see close up: squares of a hand that fills 1080 lines, inside it and with its outline.

    inside   every pixel is hand
    edges    a quarter to three quarters are

A crop shows CROP_MM of hand: 256 pixels where the picture has 0.18 mm per pixel at the depth of the joints, a finer
picture being averaged down to that. A coarser one is cut at its own scale: a crop has fewer pixels and the octaves of
its detail are longer, so that figures of unlike scales are kept apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import torch
from scipy import ndimage
from torch.nn import functional

from jghand_engine.captures.sample import Sample, TrainingImage
from jghand_engine.learn.metrics import METRIC_BOX_MIN_PX, Box, checked_picture, flip_map, psnr, ssim
from jghand_engine.learn.perceptual import PerceptualMetric, distances

INSIDE, EDGES = "inside", "edges"
# a hand of 190 mm on 1080 lines, and the side of a crop at that scale
CROP_MM_PX, CROP_PX = 0.18, 256
CROP_MM = CROP_MM_PX * CROP_PX
# pictures that are finer by less than a tenth are cut as they are: averaging them down would blur both; as much coarser
# ones are not called so
FINER_MM_PX, COARSER_MM_PX = 0.9 * CROP_MM_PX, 1.1 * CROP_MM_PX
# scales that differ by less than this are one camera's, whose hand comes and goes
_SAME_SCALE = 1.25
# crops of a picture at most, none over another of its kind: a palm holds two, an outline some more
_MOST = {INSIDE: 2, EDGES: 3}
_EDGE_SHARES = (0.25, 0.75)
# alpha that leaves no background to be seen, half a step of 8 bits below 1
_WHOLLY_HAND = 1 - 0.5 / 255

# detail: wavelengths, pixels, and the blur above which light and shade are no detail, pixels
OCTAVES_PX = ((2, 4), (4, 8), (8, 16))
_HIGH_PASS_PX = 12.0
_LUMINANCE = (0.2126, 0.7152, 0.0722)


@dataclass(frozen=True)
class CropScore:
    """category: of its picture · kind: INSIDE or EDGES · side_px: of the square · mm_px: millimeters of hand per pixel
    scores: by metric; detail_2_4 and so on are ours over the truth's, inside alone (an outline outshines all detail)
            and where the truth has any"""

    category: str
    kind: str
    side_px: int
    mm_px: float
    scores: dict[str, float]


def detail_power(rgb: np.ndarray) -> np.ndarray:
    """(3,) power of the detail in each of OCTAVES_PX, of (H, W, 3) display-referred sRGB.

    Luminance less its blur, under a Hann window, |FFT|² summed over rings of wavelengths. It says how much detail there
    is, not whether it is in its place: blur has less than the truth, noise more.
    """
    luminance = np.asarray(rgb, np.float64) @ _LUMINANCE
    fine = luminance - ndimage.gaussian_filter(luminance, _HIGH_PASS_PX)
    window = np.outer(np.hanning(fine.shape[0]), np.hanning(fine.shape[1]))
    power = np.abs(np.fft.fft2(fine * window)) ** 2
    per_px = np.hypot(np.fft.fftfreq(fine.shape[0])[:, None], np.fft.fftfreq(fine.shape[1])[None])
    return np.array([power[(per_px > 1 / long) & (per_px <= 1 / short)].sum() for short, long in OCTAVES_PX])


def millimeters_per_pixel(sample: Sample) -> float:
    """At the mean depth of the joints that the picture shows; of all where it shows none."""
    camera = sample.camera
    if camera.orthographic:
        return 1e3 / camera.fx
    px, depth_m = camera.project(sample.joints_m)
    shown = ((px >= 0) & (px < [camera.width, camera.height])).all(1)
    return 1e3 * float(depth_m[shown if shown.any() else slice(None)].mean()) / camera.fx


def places(mask: np.ndarray, side_px: int) -> dict[str, list[Box]]:
    """Where (H, W) has crops, by kind: inside as far from the outline as can be, edges as evenly halved."""
    found: dict[str, list[Box]] = {INSIDE: [], EDGES: []}
    if side_px < METRIC_BOX_MIN_PX or side_px > min(mask.shape):
        return found
    step, half = max(1, side_px // 8), side_px // 2
    tops, lefts = (np.arange(0, size - side_px + 1, step) for size in mask.shape)
    wholly = mask >= _WHOLLY_HAND
    share = _shares(mask, tops, lefts, side_px)
    inside = _shares(wholly, tops, lefts, side_px) == 1
    depth_px = np.asarray(ndimage.distance_transform_edt(wholly))[np.ix_(tops + half, lefts + half)]
    low, high = _EDGE_SHARES
    for kind, wanted, order in (
        (INSIDE, inside, -depth_px),
        (EDGES, (share >= low) & (share <= high), np.abs(share - 0.5)),
    ):
        rows, columns = np.nonzero(wanted)
        for place in np.argsort(order[rows, columns], kind="stable"):
            top, left = int(tops[rows[place]]), int(lefts[columns[place]])
            if len(found[kind]) < _MOST[kind] and all(
                abs(top - other.top) >= side_px or abs(left - other.left) >= side_px for other in found[kind]
            ):
                found[kind].append(Box(top, top + side_px, left, left + side_px))
    return found


def _shares(mask: np.ndarray, tops: np.ndarray, lefts: np.ndarray, side_px: int) -> np.ndarray:
    """(tops, lefts) mean of the mask in each square."""
    sums = np.pad(np.cumsum(np.cumsum(mask.astype(np.float64), 0), 1), ((1, 0), (1, 0)))
    corner = [sums[np.ix_(rows, columns)] for rows in (tops + side_px, tops) for columns in (lefts + side_px, lefts)]
    return np.round((corner[0] - corner[1] - corner[2] + corner[3]) / side_px**2, 9)


def crop_scores(
    sample: Sample, category: str, rgb: np.ndarray, truth: TrainingImage, perceptual: Sequence[PerceptualMetric] = ()
) -> tuple[CropScore, ...]:
    """Every crop of a picture, measured. rgb: (H, W, 3) ours, premultiplied display-referred sRGB. InputError for
    another shape than the truth's, or values that are not finite."""
    ours, theirs, mask = checked_picture("rgb", rgb, truth.mask), truth.rgb, truth.mask
    mm_px = millimeters_per_pixel(sample)
    if mm_px < FINER_MM_PX:
        ours, theirs, mask = (_averaged(one, mm_px / CROP_MM_PX) for one in (ours, theirs, mask))
        mm_px = CROP_MM_PX
    side_px = min(CROP_PX, round(CROP_MM / mm_px))
    return tuple(
        CropScore(category, kind, side_px, mm_px, _scores(kind, box.of(ours), box.of(theirs), perceptual))
        for kind, boxes in places(mask, side_px).items()
        for box in boxes
    )


def _averaged(picture: np.ndarray, factor: float) -> np.ndarray:
    """(H, W, ...) with `factor` times the pixels along each side, each the mean of those below it."""
    size = [max(1, round(factor * pixels)) for pixels in picture.shape[:2]]
    planes = torch.from_numpy(np.ascontiguousarray(picture, np.float32)).reshape(*picture.shape[:2], -1)
    small = functional.interpolate(planes.permute(2, 0, 1)[None], size, mode="area")[0].permute(1, 2, 0)
    return small.reshape(*size, *picture.shape[2:]).numpy()


def _scores(kind: str, ours: np.ndarray, truth: np.ndarray, perceptual: Sequence[PerceptualMetric]) -> dict[str, float]:
    scores = {"psnr": psnr(ours, truth), "ssim": ssim(ours, truth), **distances(perceptual, ours, truth)}
    error = flip_map(ours, truth)
    if error is not None:
        scores["flip"] = float(error.mean())
    if kind == INSIDE:
        powers = zip(OCTAVES_PX, detail_power(ours), detail_power(truth), _least_detail(truth.shape), strict=True)
        scores |= {detail_key(octave): float(power / true) for octave, power, true, least in powers if true > least}
    return scores


@cache
def _least_detail(shape: tuple[int, ...]) -> np.ndarray:
    """(3,) power of one pixel that is one step of 8 bits brighter: a truth with less has no detail to be compared."""
    picture = np.zeros(shape)
    picture[shape[0] // 2, shape[1] // 2] = 1 / 255
    return detail_power(picture)


def detail_key(octave: tuple[int, int]) -> str:
    """The name of an octave's figure, such as detail_2_4."""
    return f"detail_{octave[0]}_{octave[1]}"


def crop_groups(crops: Sequence[CropScore]) -> dict[str, tuple[CropScore, ...]]:
    """By category, kind and scale, those that there are, the finest scale first."""
    groups: dict[str, tuple[CropScore, ...]] = {}
    for scales in _alike(sorted({crop.mm_px for crop in crops})):
        low, high = f"{scales[0]:.2f}", f"{scales[-1]:.2f}"
        scale = f"{low} mm" if low == high else f"{low} to {high} mm"
        for kind in (INSIDE, EDGES):
            members = [crop for crop in crops if crop.kind == kind and scales[0] <= crop.mm_px <= scales[-1]]
            for category in dict.fromkeys(crop.category for crop in members):
                name = f"{category}, {kind}, {scale}"
                groups[name] = tuple(crop for crop in members if crop.category == category)
    return groups


def _alike(scales: Sequence[float]) -> list[list[float]]:
    """Rising scales, parted where one is much coarser than the last."""
    groups: list[list[float]] = []
    for scale in scales:
        if not groups or scale > _SAME_SCALE * groups[-1][-1]:
            groups.append([])
        groups[-1].append(scale)
    return groups


def crop_means(crops: Sequence[CropScore]) -> dict[str, float]:
    """Mean of every figure, and of detail the median: where the truth is smooth, a ratio can be of any size."""
    names = dict.fromkeys(name for crop in crops for name in crop.scores)
    values = {name: [crop.scores[name] for crop in crops if name in crop.scores] for name in names}
    return {name: float((np.median if name.startswith("detail") else np.mean)(of)) for name, of in values.items()}
