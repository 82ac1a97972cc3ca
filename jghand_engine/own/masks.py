"""Which pixels are the hand, without its forearm, by the colors of the film itself.

Skin is what lies where the detector saw bones, background what lies far from any hand, both over the whole film: the
colors of one picture are too few, and an outline that is wrong would force background in. Where the camera stands
still, what differs from the picture without the hand tells as well. GrabCut then decides in the band about the outline
what colors alone leave open.

The template ends at the wrist and the arm goes on: a line across the wrist parts them, and beyond it nothing counts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.ndimage import gaussian_filter

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.forearm import ended
from jghand_engine.errors import InputError, install_extra
from jghand_engine.hand.joints import PARENTS
from jghand_engine.own.film import FilmPictures
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import preset

# the line across the wrist lies so far towards the knuckles, of their distance: the template is sure to be there
WRIST_MARGIN_PART = 0.06
# parts of the hand's size: thickness of the bones that are surely skin; how far from outline and bones the hand may
# reach; width of the strip along the forearm that is no background
BONE_PART, BAND_PART, FOREARM_PART = 0.03, 0.14, 0.6
# what is surely the forearm, though wrists bend and are seen some millimeters off: from and to where behind the wrist,
# and how wide, parts of the hand's size
ARM_FROM_PART, ARM_TO_PART, ARM_WIDE_PART = 0.08, 0.3, 0.12
# bins of each of the three channels; how far a color says something of its neighbors, bins of light and of color; a
# color that was seen so seldom, of all pixels, says nothing
COLOR_BINS, COLOR_SPREAD_BINS, RARE = 32, (1.5, 0.8, 0.8), 1e-7
# pictures are blurred before their colors are looked up, and what the colors say after that, pixels
COLOR_BLUR_PX, ODDS_BLUR_PX = 0.8, 1.0
# what the outline says, in the units of the colors' log odds: little, as it may be wrong; beyond SURE nothing is asked
OUTLINE_ODDS, SURE_ODDS = 1.5, 3.0
# of the skin's own colors, whatever their light, the rarest this part is not taken for skin where there should be some
SKIN_RARE = 0.02
# a pixel's background is known that was seen so often without the hand; of a camera that stands still so large a part
# of what is not the hand is the background of that very pixel, and the rest is something that came to it
STILL_SEEN_MIN, STILL_PART = 3, 0.9
# nothing is known where the background of a typical pixel has more noise than this, of 255
STILL_NOISE_MAX = 8.0
# how far the background moves between pictures, of the width; features that must agree on it
CAMERA_STEP_PART_MAX, FEATURES_MIN = 0.01, 8
GRABCUT_ROUNDS = 2
# specks that an opening with a cross of so many pixels removes; holes of less than this part of the picture are filled,
# and those of which more than this part is bones, such as a tattoo on the back
OPENING_PX, HOLE_PART, MARK_PART = 3, 6e-4, 0.2

_KNUCKLES = slice(2, 6)
# bones, and the line through the knuckles
_LINES = (*((PARENTS[joint], joint) for joint in range(1, 21)), (2, 3), (3, 4), (4, 5))


def wrist_lines(joints_px: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lines across the wrist: a pixel p is on the hand's side where p·n <= limit.

    joints_px: (F, 21, 2) level order -> n (F, 2) unit, from the knuckles along the forearm, and limit (F,), pixels.
    """
    wrist = joints_px[:, 0]
    along = wrist - joints_px[:, _KNUCKLES].mean(1)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    normal = along / np.maximum(length, 1e-6)
    return normal, (wrist * normal).sum(1) - WRIST_MARGIN_PART * length[:, 0]


def wrist_side(joints_px: np.ndarray, width: int, height: int) -> np.ndarray:
    """(F, H, W) bool: pixels on the hand's side of the wrist. joints_px: (F, 21, 2) level order"""
    normal, limit = wrist_lines(joints_px)
    x, y = np.arange(width) + 0.5, np.arange(height) + 0.5
    across, down = normal[:, 0, None] * x, normal[:, 1, None] * y
    return across[:, None] + down[:, :, None] <= limit[:, None, None]


def hand_size_px(joints_px: np.ndarray) -> np.ndarray:
    """(F,) about the hand's length: twice from the wrist to the middle of the knuckles. joints_px: (F, 21, 2)"""
    return 2 * np.linalg.norm(joints_px[:, 0] - joints_px[:, _KNUCKLES].mean(1), axis=1)


@dataclass(frozen=True, eq=False)
class Zones:
    """What is known of the pixels of F pictures before their colors are looked at; all (F, H, W), bool but the outline.

    outline: 0..1, the alpha of a hand as the track or the fit has it
    band:    where the hand can be: on and about the outline and the bones
    bones:   where the detector saw bones: surely skin
    away:    surely not the hand, and not its forearm
    arm:     a strip along the middle of the forearm, from the wrist on
    side:    on the hand's side of the wrist
    """

    outline: np.ndarray
    band: np.ndarray
    bones: np.ndarray
    away: np.ndarray
    arm: np.ndarray
    side: np.ndarray


def zones_of(landmarks_px: np.ndarray, joints_px: np.ndarray, outline: np.ndarray) -> Zones:
    """landmarks_px: (F, 21, 2) as the detector saw them, level order · joints_px: (F, 21, 2) as the track or the fit
    has them · outline: (F, H, W) 0..1, of a hand of these joints"""
    cv2 = opencv()
    count, height, width = outline.shape
    side = wrist_side(joints_px, width, height)
    band, bones, away, arm = (np.zeros(outline.shape, bool) for _ in range(4))
    normals, _ = wrist_lines(joints_px)
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    for at, size in zip(range(count), hand_size_px(joints_px), strict=True):
        lines = np.zeros((height, width), np.uint8)
        ends = np.round(landmarks_px[at]).astype(int).tolist()
        for first, second in _LINES:
            cv2.line(lines, ends[first], ends[second], 1, max(2, int(BONE_PART * size)))
        reach = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * max(1, int(BAND_PART * size)) + 1,) * 2)
        band[at] = cv2.dilate(lines | (outline[at] > 0.5).astype(np.uint8), reach) > 0
        bones[at] = (lines > 0) & side[at]
        (nx, ny), (wx, wy) = normals[at], joints_px[at, 0]
        along, across = (x - wx) * nx + (y - wy) * ny, (y - wy) * nx - (x - wx) * ny
        away[at] = ~band[at] & ((along <= 0) | (np.abs(across) >= FOREARM_PART * size))
        arm[at] = (along > ARM_FROM_PART * size) & (along < ARM_TO_PART * size)
        arm[at] &= np.abs(across) < ARM_WIDE_PART / 2 * size
    return Zones(outline, band, bones, away, arm, side)


def hand_zones(avatar: HandAvatar, joints_m: np.ndarray, landmarks_px: np.ndarray, camera: Camera) -> Zones:
    """`zones_of`, by the outline of an avatar without its forearm. joints_m: (F, 21, 3) camera axes"""
    settings = replace(preset("draft"), threads=1, reuse=False, depth=False)
    renderer = HandRenderer(ended(avatar, forearm=False), settings)
    outlines = np.stack([renderer.render(joints, camera).rgba[..., 3] for joints in joints_m])
    return zones_of(landmarks_px, camera.project(joints_m)[0], outlines)


# ---- what colors say -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FilmColors:
    """How often each color is on the hand and beside it, over all pictures: (32, 32, 32) of YCrCb, each sums to 1."""

    hand: np.ndarray
    background: np.ndarray

    @property
    def overlap(self) -> float:
        """What both have in common, 0..1."""
        return float(np.minimum(self.hand, self.background).sum())

    def unlike_skin(self, rgb8: np.ndarray) -> np.ndarray:
        """(H, W) bool: pixels of a picture (H, W, 3) uint8 whose color no skin has, in whatever light."""
        hue = self.hand.sum(0).ravel()
        rising = np.sort(hue)
        least = rising[np.searchsorted(np.cumsum(rising), SKIN_RARE)]
        return hue[_places(_seen_colors(rgb8)) % hue.size] < least

    @property
    def wall_rgb(self) -> np.ndarray:
        """(3,) uint8, the most frequent color beside the hand."""
        place = np.unravel_index(self.background.argmax(), self.background.shape)
        middle = np.array([[place]]) * (256 // COLOR_BINS) + 128 // COLOR_BINS
        return opencv().cvtColor(middle.astype(np.uint8), opencv().COLOR_YCrCb2RGB)[0, 0]


def film_colors(pictures: FilmPictures, zones: Zones) -> FilmColors:
    """Skin where the detector saw bones, background farther from the hand than it can reach, without the forearm."""
    hand, background = np.zeros(COLOR_BINS**3), np.zeros(COLOR_BINS**3)
    for rgb, bones, away in zip(pictures.rgb_u8, zones.bones, zones.away, strict=True):
        places = _places(_seen_colors(rgb))
        hand += np.bincount(places[bones], minlength=len(hand))
        background += np.bincount(places[away], minlength=len(background))
    return FilmColors(*(_spread(counts) for counts in (hand, background)))


def _spread(counts: np.ndarray) -> np.ndarray:
    table = gaussian_filter(counts.reshape((COLOR_BINS,) * 3) + 1e-3, COLOR_SPREAD_BINS)
    return table / table.sum()


def _seen_colors(rgb8: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 YCrCb of a picture, a little blurred."""
    cv2 = opencv()
    return cv2.GaussianBlur(cv2.cvtColor(rgb8, cv2.COLOR_RGB2YCrCb), (0, 0), COLOR_BLUR_PX)


def _places(colors: np.ndarray) -> np.ndarray:
    """(...) where colors (..., 3) stand in the tables, which are flat."""
    y, cr, cb = np.moveaxis(colors.astype(np.int32) * COLOR_BINS // 256, -1, 0)
    return (y * COLOR_BINS + cr) * COLOR_BINS + cb


# ---- what a camera that stands still says ----------------------------------------------------------------------------


def camera_moved(pictures: FilmPictures, away: np.ndarray) -> np.ndarray:
    """(F,) bool: pictures whose background lies elsewhere than the first one's, as far as enough of it is seen. away:
    (F, H, W) bool, where no hand is"""
    cv2 = opencv()
    moved = np.zeros(len(pictures), bool)
    if not pictures.is_film:
        return moved
    grays = [cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY) for rgb in pictures.rgb_u8]
    there = cv2.goodFeaturesToTrack(grays[0], 200, 0.01, 8, mask=away[0].astype(np.uint8))
    if there is None:
        return moved
    for at, gray in enumerate(grays):
        here, found, _ = cv2.calcOpticalFlowPyrLK(grays[0], gray, there, None, maxLevel=4)
        back, again, _ = cv2.calcOpticalFlowPyrLK(gray, grays[0], here, None, maxLevel=4)
        good = (found[:, 0] > 0) & (again[:, 0] > 0) & (np.linalg.norm((back - there)[:, 0], axis=-1) < 1)
        for points in (there, here):
            x, y = np.clip(points[:, 0].astype(int), 0, np.array(gray.shape[::-1]) - 1).T
            good &= away[at, y, x]
        if good.sum() >= FEATURES_MIN:
            step = np.linalg.norm(np.median((here - there)[good, 0], axis=0)) / gray.shape[1]
            moved[at] = step > CAMERA_STEP_PART_MAX
    return moved


@dataclass(frozen=True, eq=False)
class Background:
    """The picture without the hand: colors (H, W, 3) float32 YCrCb, noise (H, W) their standard deviation, and known
    (H, W) bool, where it was seen. What is not known is zero."""

    colors: np.ndarray
    noise: np.ndarray
    known: np.ndarray

    @property
    def still(self) -> bool:
        """Whether the camera stands still, as far as the background tells."""
        return bool(self.known.any() and np.median(self.noise[self.known]) <= STILL_NOISE_MAX)

    def likelihood(self, colors: np.ndarray) -> np.ndarray:
        """(H, W) of the colors (H, W, 3) YCrCb of a picture, of a bin of `FilmColors`, as spread as these."""
        bin_width = 256 / COLOR_BINS
        spread = np.hypot(np.array(COLOR_SPREAD_BINS, np.float32) * bin_width, self.noise[..., None])
        away = (colors - self.colors) / spread
        return np.exp(-0.5 * np.square(away).sum(-1)) * np.prod(bin_width / (math.sqrt(2 * math.pi) * spread), -1)


def background_of(pictures: FilmPictures, away: np.ndarray) -> Background:
    """Medians of the pixels where the hand is away. away: (F, H, W) bool"""
    seen = np.stack([_seen_colors(rgb) for rgb in pictures.rgb_u8])
    count = away.sum(0)
    shown, noise = np.zeros(seen.shape[1:], np.float32), np.zeros(count.shape, np.float32)
    rank = np.maximum(count - 1, 0)[..., None, None]
    for row in range(len(count)):
        # what is not seen comes last
        colors = np.sort(np.where(away[:, row, :, None], seen[:, row], 255).transpose(1, 2, 0), axis=-1)
        low, middle, high = (
            np.take_along_axis(colors, rank[row] * part // 4, -1)[..., 0].astype(np.float32) for part in (1, 2, 3)
        )
        shown[row] = middle
        # between the quarters of a normal distribution are 1.35 standard deviations
        noise[row] = (high - low).max(-1) / 1.35
    return Background(shown, noise, count >= STILL_SEEN_MIN)


# ---- masks -----------------------------------------------------------------------------------------------------------


def hand_masks(pictures: FilmPictures, zones: Zones) -> np.ndarray:
    """(F, H, W) bool, the hand on its side of the wrist. The same bits each time."""
    colors = film_colors(pictures, zones)
    moved = camera_moved(pictures, zones.away)
    background = background_of(pictures, zones.away & ~moved[:, None, None]) if pictures.is_film else None
    if background is not None and not background.still:
        background = None
    masks = []
    each = zip(pictures.rgb_u8, zones.outline, zones.band, zones.bones, zones.side, moved, strict=True)
    for rgb, outline, band, bones, side, elsewhere in each:
        # whatever the forearm looks like, a sleeve included, the hand's mask is the same
        shown = np.where(side[..., None], rgb, colors.wall_rgb)
        known = None if elsewhere else background
        odds = _log_odds(_seen_colors(shown), colors, known) + OUTLINE_ODDS * (outline - 0.5)
        masks.append(_cleaned(_cut(shown, odds, band & side) & side, bones))
    return np.stack(masks)


def _log_odds(seen: np.ndarray, colors: FilmColors, background: Background | None) -> np.ndarray:
    """(H, W) of the hand against what is not the hand. seen: (H, W, 3) YCrCb"""
    places = _places(seen)
    hand, beside = colors.hand.ravel()[places], colors.background.ravel()[places]
    if background is not None:
        part = STILL_PART * background.known
        beside = part * background.likelihood(seen) + (1 - part) * beside
    odds = np.log(hand + RARE) - np.log(beside + RARE)
    return opencv().GaussianBlur(odds.astype(np.float32), (0, 0), ODDS_BLUR_PX)


def _cut(rgb8: np.ndarray, odds: np.ndarray, band: np.ndarray) -> np.ndarray:
    """(H, W) bool: GrabCut where the odds alone leave it open."""
    cv2 = opencv()
    likely = (odds > 0) & band
    zones = np.where(likely, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    zones[likely & (odds > SURE_ODDS)] = cv2.GC_FGD
    zones[~band | (odds < -SURE_ODDS)] = cv2.GC_BGD
    if not likely.any() or likely.all():
        return likely
    rows, columns = (np.flatnonzero(band.any(axis)) for axis in (1, 0))
    box = np.s_[max(rows[0] - 3, 0) : rows[-1] + 4, max(columns[0] - 3, 0) : columns[-1] + 4]
    inside = np.ascontiguousarray(zones[box])
    # its clusters begin at random
    cv2.setRNGSeed(0)
    cv2.grabCut(
        np.ascontiguousarray(rgb8[box][..., ::-1]), inside, None, np.zeros((1, 65)), np.zeros((1, 65)),
        GRABCUT_ROUNDS, cv2.GC_INIT_WITH_MASK,
    )  # fmt: skip
    cut = np.zeros_like(band)
    cut[box] = (inside == cv2.GC_FGD) | (inside == cv2.GC_PR_FGD)
    return cut


def _cleaned(mask: np.ndarray, bones: np.ndarray) -> np.ndarray:
    """Without specks, small holes and holes that bones cross, and in one piece. bones: (H, W) bool, see Zones"""
    cv2 = opencv()
    # an even one would shift the mask
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (OPENING_PX, OPENING_PX))
    opened = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, cross)
    count, holes, facts, _ = cv2.connectedComponentsWithStats(1 - opened, connectivity=4)
    area = facts[:, cv2.CC_STAT_AREA]
    filled = (area < HOLE_PART * mask.size) | (np.bincount(holes[bones], minlength=count) > MARK_PART * area)
    # number 0 is the mask itself
    filled[0] = False
    opened |= filled[holes].astype(np.uint8)
    count, pieces, facts, _ = cv2.connectedComponentsWithStats(opened, connectivity=4)
    return pieces == 1 + facts[1:, cv2.CC_STAT_AREA].argmax() if count > 1 else opened > 0


def opencv() -> Any:
    """OpenCV, which comes with MediaPipe, on one thread: its sums would differ. InputError without it."""
    try:
        import cv2
    except ImportError as error:
        raise InputError("masks", wanted="the package OpenCV", came=str(error)[:200],
                         remedy=install_extra("track")) from error  # fmt: skip
    cv2.setNumThreads(1)
    return cv2
