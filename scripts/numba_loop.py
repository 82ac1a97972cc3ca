"""A Gaussian rasterizer as it is usually written for the CPU, for comparison with ours in scripts/benchmark_frame.py.

One thread, one pixel at a time, per tile and Gaussian: the loop of OpenSplat's CPU backend (a square of tiles around
each Gaussian, math.exp per pixel), compiled by numba. It follows the contract of RENDERING 3 in what is drawn: same
projection, same cut-off (so the radius is that of the cut-off, not 3 sigma), same order, same planes. Only a
development environment has numba; the engine never imports this file.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from jghand_engine.native import contract

# numba compiles them in as constants (hence no cache on disk: it would not notice new values)
BLUR_PX2, ALPHA_MIN, ALPHA_MAX = contract.BLUR_PX2, contract.ALPHA_MIN, contract.ALPHA_MAX
T_STOP, Z_NEAR_M, TILE_PX = contract.T_STOP, contract.Z_NEAR_M, contract.TILE_PX


@numba.njit
def _project(position, sigma, fx, fy, cx, cy):
    """Center, conic and radius of every Gaussian (camera frame, meters); radius 0 means culled."""
    n = len(sigma)
    shape = np.empty((n, 6), np.float32)
    for i in range(n):
        x, y, z = position[i]
        shape[i, 5] = 0.0
        if z <= Z_NEAR_M:
            continue
        jx, jy, jxz, jyz = fx / z, fy / z, -fx * x / z**2, -fy * y / z**2
        s2 = sigma[i] ** 2
        a, c, b = s2 * (jx * jx + jxz * jxz) + BLUR_PX2, s2 * (jy * jy + jyz * jyz) + BLUR_PX2, s2 * jxz * jyz
        det = a * c - b * b
        middle = 0.5 * (a + c)
        largest = middle + math.sqrt(max(middle * middle - det, 0.1))
        shape[i, 0], shape[i, 1] = fx * x / z + cx, fy * y / z + cy
        shape[i, 2], shape[i, 3], shape[i, 4] = c / det, -b / det, a / det
        # far enough for the cut-off: 3 sigma would show the tiles
        shape[i, 5] = math.ceil(math.sqrt(2 * math.log(1 / ALPHA_MIN) * largest))
    return shape


@numba.njit
def _tile_lists(shape, order, width, height):
    """Start of each tile's list and the lists, front to back."""
    columns, rows = (width + TILE_PX - 1) // TILE_PX, (height + TILE_PX - 1) // TILE_PX
    start = np.zeros(columns * rows + 1, np.int64)
    bounds = np.zeros((len(order), 4), np.int64)
    for k in range(len(order)):
        u, v, radius = shape[order[k], 0], shape[order[k], 1], shape[order[k], 5]
        x0, x1 = max(0, int((u - radius) // TILE_PX)), min(columns, int((u + radius) // TILE_PX) + 1)
        y0, y1 = max(0, int((v - radius) // TILE_PX)), min(rows, int((v + radius) // TILE_PX) + 1)
        bounds[k] = (x0, x1, y0, y1)
        for y in range(y0, y1):
            for x in range(x0, x1):
                start[y * columns + x + 1] += 1
    start = np.cumsum(start)
    cursor, lists = start.copy(), np.empty(start[-1], np.int64)
    for k in range(len(order)):
        x0, x1, y0, y1 = bounds[k]
        for y in range(y0, y1):
            for x in range(x0, x1):
                lists[cursor[y * columns + x]] = order[k]
                cursor[y * columns + x] += 1
    return start, lists


@numba.njit
def _blend(shape, position, opacity, rgb, start, lists, planes):
    height, width = planes.shape[1:]
    columns = (width + TILE_PX - 1) // TILE_PX
    for j in range(height):
        for i in range(width):
            tile = j // TILE_PX * columns + i // TILE_PX
            transmittance, red, green, blue, depth = 1.0, 0.0, 0.0, 0.0, 0.0
            for k in range(start[tile], start[tile + 1]):
                g = lists[k]
                dx, dy = i + 0.5 - shape[g, 0], j + 0.5 - shape[g, 1]
                q = 0.5 * (shape[g, 2] * dx * dx + shape[g, 4] * dy * dy) + shape[g, 3] * dx * dy
                alpha = opacity[g] * math.exp(-q)
                if alpha < ALPHA_MIN:
                    continue
                weight = min(alpha, ALPHA_MAX) * transmittance
                red += weight * rgb[g, 0]
                green += weight * rgb[g, 1]
                blue += weight * rgb[g, 2]
                depth += weight * position[g, 2]
                transmittance -= weight
                if transmittance <= T_STOP:
                    break
            planes[0, j, i], planes[1, j, i], planes[2, j, i] = red, green, blue
            planes[3, j, i], planes[4, j, i] = 1.0 - transmittance, depth


def draw(position_c, sigma, opacity, rgb, view) -> np.ndarray:
    """Planes (5, H, W) float32, premultiplied R G B, alpha, sum of weight times depth.

    position_c (N, 3), sigma (N,), opacity (N,), rgb (N, 3): float32, camera frame, meters, all valid.
    view: (width, height, fx, fy, cx, cy), pixels. The first call compiles (seconds).
    """
    width, height, fx, fy, cx, cy = view
    shape = _project(position_c, sigma, fx, fy, cx, cy)
    order = np.argsort(position_c[:, 2], kind="stable")
    order = order[shape[order, 5] > 0]
    start, lists = _tile_lists(shape, order, width, height)
    planes = np.empty((5, height, width), np.float32)
    _blend(shape, position_c, opacity, rgb, start, lists, planes)
    return planes


def difference_to_kernel(count: int = 60_000, width: int = 512, height: int = 334) -> tuple[float, float]:
    """Milliseconds of one picture of a random ball of Gaussians, and the largest difference to the native kernel."""
    import time

    from jghand_engine.native.library import load
    from jghand_engine.native.rasterizer import GaussianArrays, NativeRasterizer, View

    random = np.random.default_rng(0)
    position = random.normal(0, 0.03, (count, 3)).astype(np.float32) + np.array([0, 0, 0.6], np.float32)
    sigma, opacity = (random.uniform(*ends, count).astype(np.float32) for ends in ((5e-4, 8e-4), (0.3, 0.95)))
    rgb = random.uniform(0, 1, (count, 3)).astype(np.float32)
    view = (width, height, 1300.0, 1300.0, width / 2, height / 2)
    draw(position, sigma, opacity, rgb, view)
    begin = time.perf_counter()
    planes = draw(position, sigma, opacity, rgb, view)
    milliseconds = (time.perf_counter() - begin) * 1e3
    library = load()
    if library is None:
        return milliseconds, math.nan
    kernel = NativeRasterizer(library, 1)
    ours = kernel.forward(GaussianArrays(position, sigma, opacity, rgb), View(*view, np.eye(3, 4)), t_stop=T_STOP)
    return milliseconds, float(np.abs(planes - ours).max())


if __name__ == "__main__":
    took, worst = difference_to_kernel()
    print(f"numba, one thread: {took:.1f} ms; largest difference to the native kernel {worst:.1e}")
