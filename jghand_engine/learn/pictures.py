"""The pictures that a training looks at again and again: cut to the hand, kept as bytes, coarser where wanted."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
import torch
from torch.nn import functional

from jghand_engine.captures.sample import Sample, load_image
from jghand_engine.errors import InputError
from jghand_engine.learn.metrics import METRIC_BOX_MIN_PX
from jghand_engine.native.tasks import SSIM_WINDOW_PX
from jghand_engine.render.camera import Camera

# pixels kept around the hand when a picture is cut to it: as far as SSIM's window and a stray Gaussian reach
CROP_MARGIN_PX = 10
# cut pictures kept in memory, bytes; 60 kB each at 512 x 334, so that 16,000 fit
PICTURE_CACHE_BYTES = 1_000_000_000


@dataclass(frozen=True)
class View:
    """One picture to compare with.

    rgb:    (H, W, 3) float32 over black
    mask:   (H, W) float32
    camera: of that cut
    """

    rgb: torch.Tensor
    mask: torch.Tensor
    camera: Camera


@dataclass(frozen=True)
class _CachedView:
    rgb: np.ndarray
    mask: np.ndarray
    camera: Camera


class Pictures:
    """Loads samples, cuts them to the hand with a margin, and keeps as many as fit into PICTURE_CACHE_BYTES."""

    def __init__(self) -> None:
        self._cache: LruCache[_CachedView] = LruCache(
            PICTURE_CACHE_BYTES, lambda view: view.rgb.nbytes + view.mask.nbytes
        )

    def view(self, sample: Sample, stride: int = 1) -> View:
        """The picture of a sample; stride 2 averages 2 x 2 pixels into one. InputError as `load_image`, or when no
        pixel of it shows the hand."""
        cached = self._cache.get(sample.image, lambda: _cut(sample))
        rgb, mask = torch.from_numpy(cached.rgb).float() / 255.0, torch.from_numpy(cached.mask).float() / 255.0
        view = View(rgb, mask, cached.camera)
        return view if stride == 1 else coarser(view, stride)


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


def _cut(sample: Sample) -> _CachedView:
    picture = load_image(sample)
    rows, columns = (np.flatnonzero(picture.mask.max(axis=axis) > 0) for axis in (1, 0))
    if not len(rows):
        raise InputError(f"mask of {sample.image}", wanted="a hand in the picture", came="an empty mask",
                         remedy="Leave that picture out, or look at it with `jghand check-data`.")  # fmt: skip
    # at stride 2 still larger than the window of SSIM, and no thinner than perceptual metrics want it
    least = max(2 * SSIM_WINDOW_PX + 2, METRIC_BOX_MIN_PX)
    top, bottom = _span(rows, picture.mask.shape[0], least)
    left, right = _span(columns, picture.mask.shape[1], least)
    camera = sample.camera
    camera = replace(camera, width=right - left, height=bottom - top, cx=camera.cx - left, cy=camera.cy - top)
    cut = slice(top, bottom), slice(left, right)
    rgb, mask = (np.round(255 * plane[cut]).astype(np.uint8) for plane in (picture.rgb, picture.mask))
    return _CachedView(rgb, mask, camera)


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
