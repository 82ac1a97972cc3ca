"""How close a picture of an avatar is to the truth: PSNR, SSIM, MS-SSIM and FLIP, on three regions.

    full   the whole picture over black, as the papers measure; black background, which is easy, raises every figure
    box    the smallest rectangle that holds every pixel of mask 0.5 or more, over black
    mask   those pixels alone (PSNR only: the others need neighbors)

Pictures are compared as float32, clipped to 0..1, not rounded to bytes. Papers differ in all of this: PAPER 2.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType

import numpy as np
import torch
from torch.nn import functional

from jghand_engine.color import decibels
from jghand_engine.errors import InputError, install_extra
from jghand_engine.learn.ssim import ssim as mean_ssim
from jghand_engine.learn.ssim import ssim_parts
from jghand_engine.native.tasks import SSIM_WINDOW_PX

# weights of the five scales of MS-SSIM, the finest first (Wang, Simoncelli, Bovik 2003)
MS_SSIM_WEIGHTS = (0.0448, 0.2856, 0.3001, 0.2363, 0.1333)
# thinnest box that is measured: what the networks of ST-LPIPS and LPIPS can halve four times
METRIC_BOX_MIN_PX = 32

BOX_RULE = "smallest rectangle around the pixels of mask >= 0.5, no margin, black background"
FLIP_MISSING = f"FLIP: not available (no package flip-evaluator). {install_extra('metrics')}"


@dataclass(frozen=True)
class Box:
    """A rectangle of pixels: rows top..bottom - 1, columns left..right - 1."""

    top: int
    bottom: int
    left: int
    right: int

    def of(self, picture: np.ndarray) -> np.ndarray:
        """The part of (H, W, ...) inside."""
        return picture[self.top : self.bottom, self.left : self.right]


def mask_box(mask: np.ndarray) -> Box:
    """The box of a mask (H, W), by BOX_RULE, but never thinner than METRIC_BOX_MIN_PX where the picture has room.

    InputError for a mask without any such pixel.
    """
    rows, columns = np.flatnonzero((mask >= 0.5).any(1)), np.flatnonzero((mask >= 0.5).any(0))
    if not len(rows):
        raise InputError("mask", wanted="pixels of a hand (0.5 or more)", came="none")
    top, bottom = _wide_enough(int(rows[0]), int(rows[-1]) + 1, mask.shape[0])
    left, right = _wide_enough(int(columns[0]), int(columns[-1]) + 1, mask.shape[1])
    return Box(top, bottom, left, right)


def _wide_enough(first: int, end: int, size: int) -> tuple[int, int]:
    missing = max(0, METRIC_BOX_MIN_PX - (end - first))
    first = max(0, min(first - missing // 2, size - METRIC_BOX_MIN_PX))
    return first, min(size, max(end, first + METRIC_BOX_MIN_PX))


def compare(rgb: np.ndarray, truth: np.ndarray, mask: np.ndarray) -> dict[str, float]:
    """Every metric of one picture: psnr, ssim, ms_ssim and (where it is installed) flip of `full` and `box`, psnr of
    `mask`, under names such as `psnr_box`.

    rgb, truth: (H, W, 3) display-referred sRGB over black, 0..1 · mask: (H, W) 0..1. InputError for unlike shapes, a
    mask without a hand, or a picture smaller than SSIM's window.
    """
    rgb, truth = checked_picture("rgb", rgb, mask), checked_picture("truth", truth, mask)
    box = mask_box(mask)
    scores = {"psnr_mask": psnr(rgb[mask >= 0.5], truth[mask >= 0.5])}
    error = flip_map(rgb, truth)
    for region, inside in (("full", Box(0, rgb.shape[0], 0, rgb.shape[1])), ("box", box)):
        ours, theirs = inside.of(rgb), inside.of(truth)
        scores[f"psnr_{region}"] = psnr(ours, theirs)
        scores[f"ssim_{region}"] = ssim(ours, theirs)
        scores[f"ms_ssim_{region}"] = ms_ssim(ours, theirs)
        if error is not None:
            scores[f"flip_{region}"] = float(inside.of(error).mean())
    return scores


def checked_picture(name: str, picture: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """`picture` as float32 clipped to 0..1. InputError unless it is (H, W, 3), finite, and as large as the mask."""
    if picture.ndim != 3 or picture.shape != (*mask.shape, 3):
        raise InputError(f"{name} to compare", wanted=f"shape {(*mask.shape, 3)}", came=str(picture.shape))
    if not np.isfinite(picture).all():
        raise InputError(f"{name} to compare", wanted="finite values", came="NaN or infinity")
    return np.clip(picture, 0, 1).astype(np.float32)


def psnr(rgb: np.ndarray, truth: np.ndarray) -> float:
    """Peak signal to noise, dB, of values 0..1 of any shape; capped at PSNR_MAX_DB, which equal pictures have."""
    return decibels(float(np.mean(np.square(rgb.astype(np.float64) - truth))))


def ssim(rgb: np.ndarray, truth: np.ndarray) -> float:
    """Mean SSIM of (H, W, 3) pictures, see `learn.ssim`."""
    return float(mean_ssim(_tensor(rgb), _tensor(truth)))


def ms_ssim(rgb: np.ndarray, truth: np.ndarray) -> float:
    """Multi-scale SSIM (Wang, Simoncelli, Bovik 2003): five scales, each half as large as the one before.

    A picture with a side below 176 pixels is first widened with black on all sides, because the last scale must still
    hold the window: the number of scales, hence the meaning of the figure, never changes.
    """
    a, b = _with_room(_tensor(rgb)), _with_room(_tensor(truth))
    product = torch.ones(3)
    for number, weight in enumerate(MS_SSIM_WEIGHTS):
        value, contrast = ssim_parts(a, b)
        last = number == len(MS_SSIM_WEIGHTS) - 1
        product = product * (value if last else contrast).mean((1, 2)).clamp_min(0) ** weight
        a, b = _halved(a), _halved(b)
    return float(product.mean())


def flip_map(rgb: np.ndarray, truth: np.ndarray) -> np.ndarray | None:
    """(H, W) perceived difference 0..1 (Andersson et al. 2020), at FLIP's default of 67 pixels per degree; None where
    the package flip-evaluator is missing. (H, W, 3) sRGB in."""
    package = flip_package()
    if package is None:
        return None
    truth, rgb = np.ascontiguousarray(truth, np.float32), np.ascontiguousarray(rgb, np.float32)
    return package.evaluate(truth, rgb, "LDR", inputsRGB=True, applyMagma=False, computeMeanError=False)[0][..., 0]


@lru_cache(maxsize=1)
def flip_package() -> ModuleType | None:
    """The package flip-evaluator, if it is installed."""
    try:
        import flip_evaluator
    except ImportError:
        return None
    return flip_evaluator


def _tensor(picture: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(np.ascontiguousarray(picture, np.float32))


def _with_room(picture: torch.Tensor) -> torch.Tensor:
    """(H, W, 3), widened evenly with black to what five scales need."""
    needed = SSIM_WINDOW_PX * 2 ** (len(MS_SSIM_WEIGHTS) - 1)
    down, across = (max(0, needed - size) for size in picture.shape[:2])
    if not (down or across):
        return picture
    return functional.pad(picture, (0, 0, across // 2, across - across // 2, down // 2, down - down // 2))


def _halved(picture: torch.Tensor) -> torch.Tensor:
    """(H, W, 3): means of 2 x 2 pixels."""
    return functional.avg_pool2d(picture.permute(2, 0, 1), 2).permute(1, 2, 0)
