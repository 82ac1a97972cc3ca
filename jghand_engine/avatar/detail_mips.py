"""Mip levels of a texture of detail: log ratios averaged over the skin alone.

The islands of the skin cover a third of the square. On every level the texels beside one take the mean of their
neighbors on it: a look-up at a seam meets nothing but skin.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jghand_engine.native.detail_task import TEXEL_ZERO, packed_texels

# steps of a packed texel per step of a byte: finer, because means lie between bytes
STEPS_PER_BYTE = 4
# texels around an island that a look-up may meet: one that the island touches, without its center, and its neighbor
RINGS = 2
# texels along the sides of the smallest level, and of a square that lies together in memory
SQUARE = 4
# texels that are tested together, at most: what that takes of memory
CELLS_MAX = 4_000_000


@dataclass(frozen=True)
class Mips:
    """texels: uint32, all levels, the finest first and the last of 4 x 4, each in squares of 4 x 4, see `packed_texels`
    most:   (levels,) the largest step away from the ratio 1 on the skin, of a byte
    """

    texels: np.ndarray
    most: np.ndarray


def mips(texture: np.ndarray, skin: np.ndarray) -> Mips:
    """texture (S, S, 3) bytes whose 128 is the ratio 1, S a power of two from 4 on; skin as of `skin_texels`."""
    levels, most, limit = [], [], TEXEL_ZERO - 1
    values = texture.astype(np.float32)
    values -= 128
    for mean in averaged_levels(values, skin):
        most.append(max(float(mean.max()), -float(mean.min())))
        mean *= STEPS_PER_BYTE
        steps = np.rint(mean, out=mean).clip(-limit, limit, out=mean).astype(np.int16)
        levels.append(packed_texels(in_squares(steps)))
    return Mips(np.concatenate(levels), np.array(most))


def averaged_levels(values: np.ndarray, skin: np.ndarray) -> Iterator[np.ndarray]:
    """The values (S, S, C) themselves, their means over twice as wide texels, and so on down to SQUARE; with rings.
    Who takes one may change it. skin: (S, S) bool, which count; others become 0"""
    value, weight = values, skin.astype(np.float32)
    value[~skin] = 0
    while True:
        mean = value / np.maximum(weight, 1)[..., None]
        with_rings(mean, weight > 0)
        yield mean
        if len(mean) == SQUARE:
            return
        # sums: each texel counts as much as there is skin in it
        value, weight = _halved(value), _halved(weight)


def with_rings(values: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """Gives texels around the skin, which a look-up there may meet, the mean of their neighbors, in place; and tells
    which ones have a value then."""
    for _ in range(RINGS):
        skin = _with_ring(values, skin)
    return skin


def filled(texture: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """The texture (S, S, 3), bytes, with means of the skin nearby wherever it shows none: no level of it holds anything
    else. skin: (S, S) bool, where it shows some, S a power of two"""
    sums, weights = [np.where(skin[..., None], texture, np.float32(0))], [skin.astype(np.float32)]
    while len(sums[-1]) > 1:
        sums.append(_halved(sums[-1]))
        weights.append(_halved(weights[-1]))
    mean = sums[-1] / np.maximum(weights[-1], 1)[..., None]
    for total, weight in zip(sums[-2::-1], weights[-2::-1], strict=True):
        coarser = mean.repeat(2, 0).repeat(2, 1)
        mean = np.where(weight[..., None] > 0, total / np.maximum(weight, 1)[..., None], coarser)
    return np.rint(mean).astype(np.uint8)


def in_squares(texels: np.ndarray) -> np.ndarray:
    """(S * S, C) of (S, S, C): squares of 4 x 4, which share a cache line, one after the other."""
    count = len(texels) // SQUARE
    return texels.reshape(count, SQUARE, count, SQUARE, -1).swapaxes(1, 2).reshape(len(texels) ** 2, -1)


def _halved(values: np.ndarray) -> np.ndarray:
    """Sums of squares of four texels."""
    rows = values[::2] + values[1::2]
    return rows[:, ::2] + rows[:, 1::2]


def _with_ring(values: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Gives texels beside those that are known the mean of these, in place; which are known then."""
    padded, size = np.pad(known, 1), len(known)
    rows = padded[:-2] | padded[1:-1] | padded[2:]
    wider = rows[:, :-2] | rows[:, 1:-1] | rows[:, 2:]
    row, column = np.nonzero(wider & ~known)
    total, count = np.zeros((len(row), values.shape[2]), np.float32), np.zeros((len(row), 1), np.float32)
    for y in (-1, 0, 1):
        for x in (-1, 0, 1):
            there = padded[1 + row + y, 1 + column + x, None]
            total += values[(row + y).clip(0, size - 1), (column + x).clip(0, size - 1)] * there
            count += there
    values[row, column] = total / count
    return wider


def skin_texels(face_uv: np.ndarray, size: int) -> np.ndarray:
    """(size, size) bool: which texels have their center in a face of (F, 3, 2); the row is 1 - v."""
    corners = np.stack([face_uv[..., 0], 1 - face_uv[..., 1]], -1).astype(np.float32) * size
    first = np.floor(corners.min(1) - 0.5).astype(np.int32).clip(0, size - 1)
    last = np.ceil(corners.max(1) - 0.5).astype(np.int32).clip(0, size - 1)
    # faces of like size together
    side = 1 << np.ceil(np.log2((last - first + 1).max(1))).astype(np.int32)
    first = np.minimum(first, size - side[:, None])
    skin = np.zeros((size, size), bool)
    for cells in np.unique(side):
        of_size = np.nonzero(side == cells)[0]
        for some in np.array_split(of_size, -(-len(of_size) * cells**2 // CELLS_MAX)):
            _cover(skin, corners[some], first[some], int(cells))
    return skin


def _cover(skin: np.ndarray, corners: np.ndarray, first: np.ndarray, cells: int) -> None:
    """Marks what faces (F, 3, 2), texels, cover of squares of so many cells from `first` (F, 2) on, in place."""
    grid = np.arange(cells, dtype=np.int32)
    column, row = first[:, :1] + grid, first[:, 1:] + grid
    x, y = column + np.float32(0.5), row + np.float32(0.5)
    sides = corners[:, [1, 2, 0]] - corners
    turn = np.sign(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])[:, None]
    inside = np.broadcast_to(turn[..., None] != 0, (len(corners), cells, cells)).copy()
    for k in range(3):
        (x0, y0), (dx, dy) = corners[:, k].T[..., None], turn * sides[:, k].T[..., None]
        inside &= (dx * (y - y0))[:, :, None] >= (dy * (x - x0))[:, None, :]
    place = row[:, :, None] * len(skin) + column[:, None, :]
    skin.reshape(-1)[place[inside]] = True
