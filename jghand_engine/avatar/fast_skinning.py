"""Posing an avatar with the native library: the same as `skinning.pose_gaussians`, in tenths of a millisecond.

Gaussians are put into an order in which neighbours in space are neighbours in memory: blocks of sixteen then share
their bones, and the rasteriser, which reads them tile by tile, finds them in the cache. Only the order among Gaussians
of exactly equal depth can tell (RENDERING 3, ties).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import RetryError
from jghand_engine.hand.fast_transform import FastBones
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.tasks import LANES, SkinTask

# bits per axis of the space-filling curve: cells of a hand's 0.2 m / 1024
_MORTON_BITS = 10


@dataclass(frozen=True)
class PosedArrays:
    """Where one avatar's Gaussians go: rows of the picture's arrays, (N, 3) and (N,) float32, contiguous.

    N is the avatar's `FastSkinning.rows`: its Gaussians rounded up to whole blocks; the rest is never drawn.
    """

    position_m: np.ndarray
    sigma_m: np.ndarray


class FastSkinning:
    """Poses one avatar again and again, without gradients.

    order: (N,) which Gaussian of the avatar stands in each row · rows: N rounded up to a multiple of 16; rows beyond N
    have sigma 0, opacity 0 · opacity (rows,), rgb (rows, 3): in that order, float32
    """

    def __init__(self, library: Library, avatar: HandAvatar) -> None:
        if (size := library.call.jg_skin_task_bytes()) != ctypes.sizeof(SkinTask):
            wanted = f"a SkinTask of {ctypes.sizeof(SkinTask)} bytes"
            raise RetryError(f"native library {library.path.name}", wanted=wanted, came=str(size))
        self._call = library.call.jg_skin
        position = avatar.position_m.numpy()
        self.order = spatial_order(position)
        self.rows = padded_rows(len(avatar))
        self.opacity = self._in_rows(avatar.opacity.numpy())
        self.rgb = self._in_rows(avatar.rgb.numpy())
        self.team = new_team()
        self._task = SkinTask(
            blocks=self.rows // LANES, stretch_min=limits.SIGMA_STRETCH_MIN, stretch_max=limits.SIGMA_STRETCH_MAX
        )
        relative = position.astype(np.float64) - avatar.canonical_joints_m[0].numpy()
        self._arrays = [self._rest(relative, avatar.sigma_m.numpy()), *self._blocks(avatar.bone_weights.numpy())]
        for name, array in zip(("rest", "block_start", "bone", "weight"), self._arrays, strict=True):
            setattr(self._task, name, array.ctypes.data)
        self._keep: tuple[object, ...] = ()

    def _in_rows(self, values: np.ndarray) -> np.ndarray:
        """(N, …) of the avatar -> (rows, …) in this order, zeros at the end."""
        out = aligned_zeros((self.rows, *values.shape[1:]))
        out[: len(values)] = values[self.order]
        return out

    def _rest(self, relative_m: np.ndarray, sigma_m: np.ndarray) -> np.ndarray:
        rest = aligned_zeros((self.rows // LANES, 4, LANES))
        columns = np.concatenate([relative_m, sigma_m[:, None]], axis=1)
        rest[...] = self._in_rows(columns).reshape(-1, LANES, 4).transpose(0, 2, 1)
        return rest

    def _blocks(self, bone_weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For every block the bones with any weight in it, and those weights: block_start, bone, weight."""
        blocked = self._in_rows(bone_weights).reshape(-1, LANES, bone_weights.shape[1]).transpose(0, 2, 1)
        block, bone = np.nonzero((blocked != 0).any(axis=2))
        start = np.zeros(len(blocked) + 1, np.int32)
        np.cumsum(np.bincount(block, minlength=len(blocked)), out=start[1:])
        weight = aligned_zeros((len(bone), LANES))
        weight[...] = blocked[block, bone]
        return start, bone.astype(np.int32), weight

    def prepare(self, bones: FastBones, into: PosedArrays, shift_m: np.ndarray) -> None:
        """Sets the next pose. Positions come out relative to the hand's root, plus `shift_m` (3,).

        InputError names an array that the kernel cannot read or write: `into` needs `rows` rows.
        """
        linear_offset = np.ascontiguousarray(bones.linear_offset, np.float32)
        task, rows = self._task, self.rows
        task.linear_offset = address(linear_offset, np.float32, "linear_offset", (JOINT_COUNT, 3, 4))
        task.position = address(into.position_m, np.float32, "position_m", (rows, 3), writable=True)
        task.sigma = address(into.sigma_m, np.float32, "sigma_m", (rows,), writable=True)
        self._task.shift = tuple(shift_m)
        self._task.scale = bones.scale
        self._keep = (linear_offset, into)
        self.team.fill(0)

    def run(self) -> None:
        """Poses the avatar; every thread of a team calls it."""
        self._call(self.team.ctypes.data, ctypes.addressof(self._task))


def padded_rows(count: int) -> int:
    """Rows that `count` Gaussians take: whole blocks."""
    return -(-count // LANES) * LANES


def spatial_order(position_m: np.ndarray) -> np.ndarray:
    """(N,) indices of points (N, 3) along a Z-order curve: near in the list means near in space."""
    low = position_m.min(axis=0, initial=0.0)
    size = float((position_m - low).max(initial=0.0)) or 1.0
    cells = np.clip((position_m - low) / size * (2**_MORTON_BITS - 1), 0, 2**_MORTON_BITS - 1).astype(np.uint64)
    code = np.zeros(len(position_m), np.uint64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")
