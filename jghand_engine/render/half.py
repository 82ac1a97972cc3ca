"""Pictures drawn at half the width and height, then enlarged: for large pictures and slow machines.

Color and alpha are interpolated between the four nearest pixels. They are premultiplied, so that edges stay right
against any background. To keep colors of different depths apart gains below 0.15 dB on the shipped hands and costs as
much as drawing, so they are not. Depths are kept apart: a mean of finger and palm would lie where there is nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jghand_engine import limits
from jghand_engine.native.binding import Library
from jghand_engine.native.enlarge import native_enlarged
from jghand_engine.render.camera import Camera


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


def enlarged(
    rgba: np.ndarray, depth_m: np.ndarray, camera: Camera, library: Library | None = None, threads: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """(H, W, 4) float32 premultiplied and (H, W) float32 meters, 0 where there is nothing, of `halved(camera)` -> those
    of `camera`. By the compiled kernel where there is a library."""
    if library is None:
        return enlarged_color(rgba, camera.width, camera.height), enlarged_depth(depth_m, camera.width, camera.height)
    return native_enlarged(library, rgba, depth_m, (camera.width, camera.height), threads)


def enlarged_color(rgba: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W, 4) float32 premultiplied of `halved` -> (height, width, 4), interpolated; beyond the edge it goes on."""
    return np.swapaxes(_doubled(np.swapaxes(_doubled(rgba, height), 0, 1), width), 0, 1)


def _doubled(values: np.ndarray, count: int) -> np.ndarray:
    """Twice as many rows, or one less: three quarters of the nearest and one of the next."""
    edged = np.concatenate([values[:1], values, values[-1:]])
    out = np.empty((2 * len(values), *values.shape[1:]), np.float32)
    for place, beside in ((0, edged[:-2]), (1, edged[2:])):
        out[place::2] = np.float32(0.75) * values + np.float32(0.25) * beside
    return out[:count]


def enlarged_depth(depth_m: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) float32 meters, 0 where there is nothing -> (height, width): the mean of those of the four nearest pixels
    that show the same surface as the nearest one does."""
    out = np.empty((height, width), np.float32)
    edged = np.pad(depth_m, 1, mode="edge")
    for down in (0, 1):
        for across in (0, 1):
            y, x = 2 * down - 1, 2 * across - 1
            total, weight = 9 * depth_m, np.full_like(depth_m, 9)
            for dy, dx, share in ((y, 0, 3), (0, x, 3), (y, x, 1)):
                other = edged[1 + dy : len(edged) - 1 + dy, 1 + dx : edged.shape[1] - 1 + dx]
                same = share * (np.abs(other - depth_m) < limits.SAME_SURFACE_M)
                total += same * other
                weight += same
            place = out[down::2, across::2]
            place[...] = (total / weight)[: place.shape[0], : place.shape[1]]
    return out


def repeated(values: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W, …) -> (height, width, …): what cannot be mixed, such as the numbers of hands."""
    return values.repeat(2, 0).repeat(2, 1)[:height, :width]
