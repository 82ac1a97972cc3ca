"""The mean of images in linear light, premultiplied, by the native kernel: what the sensor of a camera adds up.

Images come in and go out as they are blended: display-referred, or scene-linear.
"""

from __future__ import annotations

import ctypes

import numpy as np

from jghand_engine.native import contract
from jghand_engine.native.binding import Library, address, new_team
from jghand_engine.native.threads import shared_pool

# items that threads share
STRIPES = 16

_I32, _F32, _P = ctypes.c_int32, ctypes.c_float, ctypes.c_void_p


class MeanTask(ctypes.Structure):
    """MeanTask of native/mean.cpp, field by field."""

    _fields_ = (
        *((name, _I32) for name in ("width", "height", "stride", "stripes", "linear")),
        *((name, _F32) for name in ("weight", "alpha_min")),
        *((name, _P) for name in ("rgba", "depth", "sum", "depth_sum", "depth_weight")),
    )


class NativeMean:
    """The mean of images of one size, or of parts of them. linear: whether they are scene-linear"""

    def __init__(self, library: Library, threads: int, width: int, height: int, *, linear: bool = False) -> None:
        self._call, self._pool, self._linear = library.call, shared_pool(threads), linear
        self._sum = np.zeros((height, width, 4), np.float32)
        self._depth_sum, self._depth_weight = np.zeros((2, height, width), np.float32)

    def add(self, rgba: np.ndarray, depth_m: np.ndarray | None, left: int, top: int, weight: float) -> None:
        """rgba (h, w, 4) and depth_m (h, w) float32, whose first pixel lies at `left`, `top`; weights sum to 1."""
        height, width = rgba.shape[:2]
        task = self._task(width, height, top * self._sum.shape[1] + left)
        task.weight, task.rgba = weight, address(rgba, np.float32, "rgba", (height, width, 4))
        if depth_m is not None:
            task.depth = address(depth_m, np.float32, "depth", (height, width))
        self._run(self._call.jg_mean_add, task)

    def finish(self) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 4) and the mean depth of all that covers a pixel (H, W), meters, 0 where hardly anything does."""
        height, width = self._depth_sum.shape
        rgba, depth_m = np.zeros((height, width, 4), np.float32), np.zeros((height, width), np.float32)
        task = self._task(width, height, 0)
        task.rgba, task.depth, task.alpha_min = rgba.ctypes.data, depth_m.ctypes.data, contract.DEPTH_ALPHA_MIN
        self._run(self._call.jg_mean_finish, task)
        return rgba, depth_m

    def _task(self, width: int, height: int, first: int) -> MeanTask:
        """Over sums that begin at pixel `first`."""
        task = MeanTask(width=width, height=height, stride=self._sum.shape[1], stripes=STRIPES, linear=self._linear)
        task.sum = self._sum.ctypes.data + 16 * first
        task.depth_sum, task.depth_weight = (a.ctypes.data + 4 * first for a in (self._depth_sum, self._depth_weight))
        return task

    def _run(self, call, task: MeanTask) -> None:
        team, place = new_team(), ctypes.addressof(task)
        counters = team.ctypes.data
        self._pool.run(lambda _thread: call(counters, place))
