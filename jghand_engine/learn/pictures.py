"""The pictures that a training looks at again and again: cut to the hand, kept as bytes, coarser where wanted."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import torch
from torch.nn import functional

from jghand_engine.captures.known_light import KnownLight, LitPicture, load_groups, mix, random_weights
from jghand_engine.captures.sample import Sample, load_image
from jghand_engine.color import SRGB_EXPONENT, SRGB_OFFSET, SRGB_SLOPE, SRGB_TOE
from jghand_engine.errors import InputError
from jghand_engine.learn.metrics import METRIC_BOX_MIN_PX
from jghand_engine.native.tasks import SSIM_WINDOW_PX
from jghand_engine.render.camera import Camera

# pixels kept around the hand when a picture is cut to it: as far as SSIM's window and a stray Gaussian reach
CROP_MARGIN_PX = 10
# cut pictures kept in memory, bytes; 1 MB each of 501 x 768, 4 MB where light groups are apart: a capture of 400 fits
PICTURE_CACHE_BYTES = 2_000_000_000


@dataclass(frozen=True)
class MixedLight:
    """image: of a picture · light: all of it · weight: (G, 3) of its groups · exposure: as in MixedPicture"""

    image: Path
    light: KnownLight
    weight: np.ndarray
    exposure: float


@dataclass(frozen=True)
class View:
    """One picture to compare with.

    rgb:    (H, W, 3) float32 over black
    mask:   (H, W) float32
    camera: of that cut
    lit:    what lights it where that is known; then rgb is `tone` of it, exposed
    """

    rgb: torch.Tensor
    mask: torch.Tensor
    camera: Camera
    lit: MixedLight | None = None


class Pictures:
    """Loads samples, cuts them to the hand with a margin, and keeps as many as fit into PICTURE_CACHE_BYTES.
    known_light: whether their lights are taken apart, which are known then"""

    def __init__(self, *, known_light: bool = False) -> None:
        self._known_light = known_light
        self._cache: LruCache[tuple[np.ndarray, np.ndarray, Camera]] = LruCache(
            PICTURE_CACHE_BYTES, lambda cut: cut[0].nbytes + cut[1].nbytes
        )
        self._groups: LruCache[tuple[LitPicture, Camera]] = LruCache(
            PICTURE_CACHE_BYTES, lambda cut: cut[0].groups.nbytes
        )

    def view(self, sample: Sample, stride: int = 1, seed: Sequence[int] | None = None) -> View:
        """The picture of a sample; stride 2 averages 2 x 2 pixels into one. seed: of a mix of its lights, where they
        are known; None: all of them as they are. InputError as `load_image`, or when no pixel of it shows the hand."""
        if self._known_light and sample.light is not None:
            return self._lit(sample, sample.light, stride, seed)
        *planes, camera = self._cache.get(sample.image, lambda: _cut(sample))
        rgb, mask = (torch.from_numpy(plane).float() / 255.0 for plane in planes)
        view = View(rgb, mask, camera)
        return view if stride == 1 else coarser(view, stride)

    def _lit(self, sample: Sample, light: KnownLight, stride: int, seed: Sequence[int] | None) -> View:
        groups, camera = self._groups.get(sample.image, lambda: _cut_groups(sample))
        weight = np.ones((light.groups, 3))
        if seed is not None:
            weight = random_weights(light, np.random.default_rng([*seed]))
        one = mix(groups, weight)
        view = View(torch.from_numpy(one.rgb), torch.from_numpy(one.alpha), camera)
        if stride > 1:
            view = coarser(view, stride)
        lit = MixedLight(sample.image, light, weight, one.exposure)
        return replace(view, rgb=tone(view.rgb * one.exposure), lit=lit)


def tone(linear: torch.Tensor) -> torch.Tensor:
    """Scene-linear light as losses compare it: sRGB's curve up to 1, and its logarithm beyond with the same slope, so
    that highlights count and do not rule."""
    dark = SRGB_SLOPE * linear
    # the power's gradient is not finite at 0
    power = linear.clamp(SRGB_TOE / SRGB_SLOPE, 1) ** (1 / SRGB_EXPONENT)
    middle = (1 + SRGB_OFFSET) * power - SRGB_OFFSET
    bright = 1 + (1 + SRGB_OFFSET) / SRGB_EXPONENT * linear.clamp_min(1).log()
    return torch.where(linear <= SRGB_TOE / SRGB_SLOPE, dark, torch.where(linear <= 1, middle, bright))


def coarser(view: View, stride: int) -> View:
    """Every `stride` x `stride` pixels averaged into one; what is left over at the right and below is dropped."""
    planes = torch.cat([view.rgb, view.mask[..., None]], -1).permute(2, 0, 1)[None]
    small = functional.avg_pool2d(planes, stride)[0].permute(1, 2, 0)
    camera = view.camera
    camera = replace(
        camera,
        width=small.shape[1],
        height=small.shape[0],
        **{name: getattr(camera, name) / stride for name in ("fx", "fy", "cx", "cy")},
    )
    return View(small[..., :3].contiguous(), small[..., 3].contiguous(), camera)


def _cut(sample: Sample) -> tuple[np.ndarray, np.ndarray, Camera]:
    """(h, w, 3) and (h, w) uint8 rgb and mask of the part with the hand, and its camera."""
    picture = load_image(sample)
    rows, columns = (np.flatnonzero(picture.mask.max(axis=axis) > 0) for axis in (1, 0))
    if not len(rows):
        raise InputError(f"mask of {sample.image}", wanted="a hand in the picture", came="an empty mask",
                         remedy="Leave that picture out, or look at it with `jghand check-data`.")  # fmt: skip
    # at stride 2 still larger than the window of SSIM, and no thinner than perceptual metrics want it
    least = max(2 * SSIM_WINDOW_PX + 2, METRIC_BOX_MIN_PX)
    top, bottom = _span(rows, picture.mask.shape[0], least)
    left, right = _span(columns, picture.mask.shape[1], least)
    planes = (plane[top:bottom, left:right] for plane in (picture.rgb, picture.mask))
    rgb, mask = (np.round(255 * plane).astype(np.uint8) for plane in planes)
    return rgb, mask, sample.camera.part(left, top, right - left, bottom - top)


def _cut_groups(sample: Sample) -> tuple[LitPicture, Camera]:
    """The lights of a picture apart, as of one that is no larger than the part with the hand; and its camera."""
    whole = load_groups(sample)
    (left, top), (rows, columns) = whole.corner_px, whole.alpha.shape
    least = max(2 * SSIM_WINDOW_PX + 2, METRIC_BOX_MIN_PX)
    low_y, high_y = _span(top + np.arange(rows), whole.size_px[1], least)
    low_x, high_x = _span(left + np.arange(columns), whole.size_px[0], least)
    size_px = high_x - low_x, high_y - low_y
    return replace(whole, corner_px=(left - low_x, top - low_y), size_px=size_px), sample.camera.part(
        low_x, low_y, *size_px
    )


def _span(filled: np.ndarray, size: int, least: int) -> tuple[int, int]:
    """From the first to behind the last filled line, with a margin, inside the picture."""
    low, high = max(int(filled[0]) - CROP_MARGIN_PX, 0), min(int(filled[-1]) + 1 + CROP_MARGIN_PX, size)
    if high - low < least:
        low = max(min(low, size - least), 0)
        high = min(low + least, size)
    return low, high


Value = TypeVar("Value")


class LruCache(Generic[Value]):
    """Keeps what was used last, up to `room` bytes, and always the newest. size_of: bytes of a value."""

    def __init__(self, room: int, size_of: Callable[[Value], int]) -> None:
        self._room, self._size_of = room, size_of
        self._kept: OrderedDict[Hashable, Value] = OrderedDict()
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._kept)

    def get(self, key: Hashable, make: Callable[[], Value]) -> Value:
        """The value of `key`, made when it is not there; the longest unused go when there is no room for it."""
        if key in self._kept:
            self._kept.move_to_end(key)
            return self._kept[key]
        value = make()
        self._kept[key] = value
        self._bytes += self._size_of(value)
        while self._bytes > self._room and len(self._kept) > 1:
            _, oldest = self._kept.popitem(last=False)
            self._bytes -= self._size_of(oldest)
        return value
