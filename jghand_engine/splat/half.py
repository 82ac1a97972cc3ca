"""Pictures drawn at half the width and height, then enlarged: for large pictures and slow machines.

Colour and alpha are interpolated between the four nearest pixels. They are premultiplied, so that edges stay right
against any background. To keep colours of different depths apart gains below 0.15 dB on the shipped hands and costs as
much as drawing, so they are not. Depths are kept apart: a mean of finger and palm would lie where there is nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jghand_engine import limits
from jghand_engine.native.threads import shared_pool
from jghand_engine.splat.camera import Camera


def halved(camera: Camera) -> Camera:
    """The same view on pixels twice as large, which cover at least the whole picture."""
    return replace(
        camera,
        width=(camera.width + 1) // 2,
        height=(camera.height + 1) // 2,
        fx=0.5 * camera.fx,
        fy=0.5 * camera.fy,
        cx=0.5 * camera.cx,
        cy=0.5 * camera.cy,
    )


def enlarged_colour(rgba: np.ndarray, width: int, height: int, threads: int = 1) -> np.ndarray:
    """(H, W, 4) float32 premultiplied of `halved` -> (height, width, 4), interpolated; beyond the edge it goes on."""
    out = np.empty((height, width, 4), np.float32)

    def band(rows: np.ndarray, target: np.ndarray) -> None:
        tall = np.empty((2 * (len(rows) - 2), rows.shape[1] + 2, 4), np.float32)
        middle = np.float32(0.75) * rows[1:-1]
        np.add(middle, np.float32(0.25) * rows[:-2], out=tall[0::2, 1:-1])
        np.add(middle, np.float32(0.25) * rows[2:], out=tall[1::2, 1:-1])
        tall[:, 0], tall[:, -1] = tall[:, 1], tall[:, -2]
        tall = tall[: len(target)]
        middle = np.float32(0.75) * tall[:, 1:-1]
        left, right = (np.float32(0.25) * side for side in (tall[:, :-2], tall[:, 2:]))
        np.add(middle, left, out=target[:, 0::2])
        np.add(middle[:, : width // 2], right[:, : width // 2], out=target[:, 1::2])

    _in_bands(rgba, out, band, threads)
    return out


def enlarged_depth(depth_m: np.ndarray, width: int, height: int, threads: int = 1) -> np.ndarray:
    """(H, W) float32 metres, 0 where there is nothing -> (height, width): the mean of those of the four nearest pixels
    that show the same surface as the nearest one does."""
    out = np.empty((height, width), np.float32)

    def band(rows: np.ndarray, target: np.ndarray) -> None:
        wide = np.pad(rows, ((0, 0), (1, 1)), mode="edge")
        nearest = wide[1:-1, 1:-1]
        for down in (0, 1):
            for across in (0, 1):
                y, x = 2 * down - 1, 2 * across - 1
                total, weight = 9 * nearest, np.full_like(nearest, 9)
                for dy, dx, share in ((y, 0, 3), (0, x, 3), (y, x, 1)):
                    other = wide[1 + dy : len(wide) - 1 + dy, 1 + dx : wide.shape[1] - 1 + dx]
                    same = share * (np.abs(other - nearest) < limits.SAME_SURFACE_M)
                    total += same * other
                    weight += same
                place = target[down::2, across::2]
                place[...] = (total / weight)[: place.shape[0], : place.shape[1]]

    _in_bands(depth_m, out, band, threads)
    return out


def repeated(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W, …) -> (height, width, …): what cannot be mixed, such as the numbers of hands."""
    return values.repeat(2, 0).repeat(2, 1)[:height, :width]


def _in_bands(
    small: np.ndarray, large: np.ndarray, band: Callable[[np.ndarray, np.ndarray], None], threads: int
) -> None:
    """Calls `band` for pieces that stay in the cache: rows of `small` and one more on each side, rows of `large`."""
    edged = np.concatenate([small[:1], small, small[-1:]])
    step = limits.HALF_BAND_ROWS

    def one(index: int) -> None:
        first = index * step
        band(edged[first : first + step + 2], large[2 * first : 2 * (first + step)])

    if small.any():
        shared_pool(threads).map(one, -(-len(small) // step))
    else:
        large.fill(0)
