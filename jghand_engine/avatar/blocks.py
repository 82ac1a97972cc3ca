"""Gaussians in the order in which the kernels read them: blocks of sixteen neighbors in space.

Blocks then share their bones and their shadows, and the rasterizer, which reads them tile by tile, finds them in the
cache. Only the order among Gaussians of exactly equal depth can tell (RENDERING 3, ties).
"""

from __future__ import annotations

import ctypes
import functools

import numpy as np

from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.tasks import LANES

# orders that are not found anew: a hand has four, of some 80 ms, and its renderer is made again with other settings
ORDERS_KEPT = 16


class Blocks:
    """Gaussians in blocks of sixteen neighbors, as the kernels read them.

    order: (N,) which Gaussian stands in each row · rows: N rounded up to a multiple of 16
    """

    def __init__(self, order: np.ndarray) -> None:
        self.order = order
        self.rows = padded_rows(len(order))

    @classmethod
    def of(cls, position_m: np.ndarray) -> Blocks:
        """Of neighbors, by their places (N, D)."""
        places = np.ascontiguousarray(position_m)
        return cls(_known_order(places.tobytes(), places.dtype, places.shape[1]))

    @property
    def count(self) -> int:
        return self.rows // LANES

    def in_rows(self, values: np.ndarray, dtype: type = np.float32) -> np.ndarray:
        """(N, …) in the Gaussians' own order -> (rows, …) in this one, zeros at the end."""
        out = aligned_zeros((self.rows, *values.shape[1:]), dtype)
        out[: len(values)] = values[self.order]
        return out

    def blocked(self, values: np.ndarray, dtype: type = np.float32) -> np.ndarray:
        """(N, C) -> (blocks, C, 16)."""
        out = aligned_zeros((self.count, values.shape[1], LANES), dtype)
        out[...] = self.in_rows(values, dtype).reshape(-1, LANES, values.shape[1]).transpose(0, 2, 1)
        return out

    def bones(self, bone_weights: np.ndarray) -> dict[str, np.ndarray]:
        """For every block the bones with any weight in it, and those weights: block_start, bone, weight of SkinTask."""
        blocked = self.blocked(bone_weights)
        block, bone = np.nonzero((blocked != 0).any(axis=2))
        start = np.zeros(self.count + 1, np.int32)
        np.cumsum(np.bincount(block, minlength=self.count), out=start[1:])
        weight = aligned_zeros((len(bone), LANES))
        weight[...] = blocked[block, bone]
        return {"block_start": start, "bone": bone.astype(np.int32), "weight": weight}


def padded_rows(count: int) -> int:
    """Rows that `count` Gaussians take: whole blocks."""
    return -(-count // LANES) * LANES


@functools.lru_cache(maxsize=ORDERS_KEPT)
def _known_order(content: bytes, kind: np.dtype, columns: int) -> np.ndarray:
    order = compact_order(np.frombuffer(content, kind).reshape(-1, columns))
    order.flags.writeable = False
    return order


def compact_order(position_m: np.ndarray) -> np.ndarray:
    """(N,) indices of points (N, D) by halves of halves: sixteens are nearer to each other than along a space-filling
    curve, which jumps."""
    parts, order = [np.arange(len(position_m))], []
    while parts:
        part = parts.pop()
        if len(part) <= LANES:
            order.append(part)
            continue
        longest = np.ptp(position_m[part], axis=0).argmax()
        part = part[np.argsort(position_m[part, longest], kind="stable")]
        middle = padded_rows(len(part) // 2)
        parts += [part[middle:], part[:middle]]
    return np.concatenate(order)


def set_pointers(task: ctypes.Structure, arrays: dict[str, np.ndarray]) -> None:
    """Lets the task's fields point to arrays, which the caller keeps."""
    for name, array in arrays.items():
        setattr(task, name, array.ctypes.data)
