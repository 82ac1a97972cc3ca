"""Images at twice the width and height by the native kernel.

Color and alpha are interpolated between the four nearest pixels. They are premultiplied, so that edges stay right
against any background. To keep colors of different depths apart gains below 0.15 dB on the shipped hands and costs as
much as drawing, so they are not. Depths are kept apart: a mean of finger and palm would lie where there is nothing.
"""

from __future__ import annotations

import ctypes

import numpy as np

from jghand_engine.native.binding import Library, address, new_team
from jghand_engine.native.tasks import EnlargeTask
from jghand_engine.native.threads import shared_pool

# depths that differ by less are of one surface, meters: less than a finger's thickness, more than a pixel's slope
SAME_SURFACE_M = 0.005

# items that threads share
STRIPES = 16


def native_enlarged(
    library: Library, rgba: np.ndarray, depth_m: np.ndarray, size_px: tuple[int, int], threads: int
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 4) and (H, W) float32 -> the same of (height, width); size_px: width and height, 2 W or 2 W - 1 and
    2 H or 2 H - 1. InputError for another dtype, unlike shapes or strided memory."""
    height, width = depth_m.shape
    large_width, large_height = size_px
    spans = np.empty((height, 2), np.int32)
    # zeros that nobody writes cost nothing: most of an image is empty
    large_rgba = np.zeros((large_height, large_width, 4), np.float32)
    large_depth_m = np.zeros((large_height, large_width), np.float32)
    task = EnlargeTask(
        width=width,
        height=height,
        large_width=large_width,
        large_height=large_height,
        stripes=STRIPES,
        same_surface=SAME_SURFACE_M,
        rgba=address(rgba, np.float32, "rgba", (height, width, 4)),
        depth=address(depth_m, np.float32, "depth", (height, width)),
        spans=spans.ctypes.data,
        large_rgba=large_rgba.ctypes.data,
        large_depth=large_depth_m.ctypes.data,
    )
    team = new_team()
    place, counters = ctypes.addressof(task), team.ctypes.data
    shared_pool(threads).run(lambda _thread: library.call.jg_enlarge(counters, place))
    return large_rgba, large_depth_m
