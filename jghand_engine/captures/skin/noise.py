"""Fields of chance in space: smooth noise and cells. Points in, numbers out, so that nothing has a seam in a texture.

The same seed gives the same field, whichever points are asked for.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import KDTree

# cells after which noise repeats: at the finest grain, 0.34 mm, that is 22 mm
PERIOD = 64
# brings smoothly interpolated values that are even in +-0.5 to a spread of about 1
SPREAD = 5.4
# of a cell's number in its three indices, room for that many each way: 2^20 cells of 0.5 mm are half a kilometer
_BITS = 20


def smoothstep(low: float, high: float, x: np.ndarray | float) -> np.ndarray:
    """0 at `low` and beyond, 1 at `high` and beyond, smooth between; low may be the larger one."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def gauss(x: np.ndarray, width: float | np.ndarray) -> np.ndarray:
    """exp(-x^2 / 2 width^2)."""
    return np.exp(-0.5 * (x / width) ** 2)


def noise(points: np.ndarray, cell: float, seed: tuple[int, ...]) -> np.ndarray:
    """(N,) value noise of about zero mean and unit spread at `points` (N, 3), features of about `cell` across."""
    lattice = np.random.default_rng(seed).random((PERIOD,) * 3, dtype=np.float32) - 0.5
    q = points.T / cell
    low = np.floor(q)
    t = q - low
    return SPREAD * map_coordinates(lattice, low + t * t * (3 - 2 * t), order=1, mode="grid-wrap")


def fractal_noise(points: np.ndarray, cell: float, seed: tuple[int, ...], octaves: int = 3) -> np.ndarray:
    """(N,) sum of noises, each half as coarse as the last and 0.55 as strong; about unit spread."""
    gains = 0.55 ** np.arange(octaves)
    parts = (gain * noise(points, cell / 2**k, (*seed, k)) for k, gain in enumerate(gains))
    return sum(parts, np.zeros(len(points), np.float32)) / np.linalg.norm(gains)


def cells(points: np.ndarray, cell: float, seed: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells around one random point in each cube of edge `cell` (Worley 1996), at `points` (N, 3).

    -> (N,) distance to the border of the own cell, (N,) distance to its point, (N,) a number 0..1 of the cell.
    """
    keys = np.unique(_key(np.floor(points / cell).astype(np.int64)))
    for shift in (0, _BITS, 2 * _BITS):  # and all cubes around those
        keys = np.unique(np.concatenate([keys, keys - (1 << shift), keys + (1 << shift)]))
    cubes = np.stack([(keys >> shift) & (2**_BITS - 1) for shift in (2 * _BITS, _BITS, 0)], 1) - 2 ** (_BITS - 1)
    chance = _hashed(keys, seed)
    centers = (cubes + chance[:, :3]) * cell
    distance, nearest = map(np.asarray, KDTree(centers).query(points, k=2))
    apart = np.linalg.norm(centers[nearest[:, 1]] - centers[nearest[:, 0]], axis=1)
    border = (distance[:, 1] ** 2 - distance[:, 0] ** 2) / (2 * np.maximum(apart, np.finfo(np.float32).tiny))
    return border.astype(np.float32), distance[:, 0].astype(np.float32), chance[nearest[:, 0], 3].astype(np.float32)


def _key(cube: np.ndarray) -> np.ndarray:
    """Indices (..., 3) of a cube, of either sign -> its number (...)."""
    i, j, k = np.moveaxis(cube + 2 ** (_BITS - 1), -1, 0)
    return (i << 2 * _BITS) + (j << _BITS) + k


def _hashed(keys: np.ndarray, seed: tuple[int, ...]) -> np.ndarray:
    """(K, 4) numbers 0..1 of each key: splitmix64 (Steele, Lea and Flood 2014) from the key and the seed."""
    state = keys.astype(np.uint64) ^ np.random.default_rng(seed).integers(2**63, dtype=np.uint64)
    numbers = []
    for _ in range(4):
        state = state + np.uint64(0x9E3779B97F4A7C15)
        z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        numbers.append(((z ^ (z >> np.uint64(31))) >> np.uint64(11)) * 2.0**-53)
    return np.stack(numbers, 1)
