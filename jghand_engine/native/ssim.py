"""The similarity of two images by the native kernel; its specification is learn/ssim.py."""

from __future__ import annotations

import ctypes
import math

import numpy as np

from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.tasks import LANES, SSIM_WINDOW_PX, SsimTask
from jghand_engine.native.threads import shared_pool

SSIM_SIGMA_PX = 1.5
SSIM_K1 = 0.01
SSIM_K2 = 0.03

CHANNELS = 3
# items that threads share; each keeps its rows of the window in the fastest memory
STRIPES = 8


def window() -> np.ndarray:
    """(11,) float64 weights of the window along one axis, sum 1."""
    half = SSIM_WINDOW_PX // 2
    weights = np.exp(-(np.arange(-half, half + 1) ** 2) / (2 * SSIM_SIGMA_PX**2))
    return weights / weights.sum()


class NativeSsim:
    """Memory for the kernel, kept from call to call. One call at a time."""

    def __init__(self, library: Library, threads: int) -> None:
        self._call, self._pool, self._team = library.call.jg_ssim, shared_pool(threads), new_team()
        self._maps, self._scratch = aligned_zeros((0,)), aligned_zeros((0,))
        self._weights = (ctypes.c_float * SSIM_WINDOW_PX)(*window().tolist())

    def mean(self, rgb: np.ndarray, truth: np.ndarray) -> float:
        """Mean SSIM of (H, W, 3) float32 images no smaller than the window.

        InputError for another dtype, unlike shapes or strided memory.
        """
        return self._run(rgb, truth, None)

    def mean_and_gradient(self, rgb: np.ndarray, truth: np.ndarray) -> tuple[float, np.ndarray]:
        """As `mean`, and its gradient with respect to rgb, (H, W, 3) float32."""
        gradient = np.empty(rgb.shape, np.float32)
        return self._run(rgb, truth, gradient), gradient

    def _run(self, rgb: np.ndarray, truth: np.ndarray, gradient: np.ndarray | None) -> float:
        height, width = rgb.shape[:2]
        shape, rim = (height, width, CHANNELS), SSIM_WINDOW_PX - 1
        stride = math.ceil((CHANNELS * (width + rim) + 2 * LANES) / LANES) * LANES
        sums = np.zeros(height - rim)
        self._maps = _at_least(self._maps, 0 if gradient is None else CHANNELS * (height + rim) * stride)
        self._scratch = _at_least(self._scratch, STRIPES * 4 * stride)
        task = SsimTask(
            width=width,
            height=height,
            stride=stride,
            stripes=STRIPES,
            c1=SSIM_K1**2,
            c2=SSIM_K2**2,
            weights=self._weights,
            rgb=address(rgb, np.float32, "rgb", shape),
            truth=address(truth, np.float32, "truth", shape),
            maps=self._maps.ctypes.data,
            scratch=self._scratch.ctypes.data,
            sums=sums.ctypes.data,
            gradient=None if gradient is None else address(gradient, np.float32, "gradient", shape, writable=True),
        )
        self._team.fill(0)
        team, place = self._team.ctypes.data, ctypes.addressof(task)
        self._pool.run(lambda _thread: self._call(team, place))
        return float(sums.sum()) / (sums.size * (width - rim) * CHANNELS)


def _at_least(memory: np.ndarray, floats: int) -> np.ndarray:
    return memory if len(memory) >= floats else aligned_zeros((floats,))
