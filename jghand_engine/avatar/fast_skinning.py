"""Posing an avatar with the native library: the same as `skinning.pose_gaussians`, in tenths of a millisecond.

Gaussians are put into an order in which neighbors in space are neighbors in memory: blocks of sixteen then share
their bones, and the rasterizer, which reads them tile by tile, finds them in the cache. Only the order among Gaussians
of exactly equal depth can tell (RENDERING 3, ties).
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from jghand_engine import limits
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.errors import RetryError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.skeleton import Bones
from jghand_engine.limits import QUATERNION_MIN
from jghand_engine.native.binding import Library, address, aligned_zeros, new_team
from jghand_engine.native.tasks import LANES, SkinTask

# bits per axis of the space-filling curve: cells of a hand's 0.2 m / 1024
_MORTON_BITS = 10


@dataclass(frozen=True)
class PosedArrays:
    """Where one avatar's Gaussians go: rows of the picture's arrays, (N, 3), (N,) and (N, 6) float32, contiguous.

    N is the avatar's `FastSkinning.rows`: its Gaussians rounded up to whole blocks; the rest is never drawn.
    covariance_m2: as in `Gaussians`, of spheres too; None where no hand of the picture has ellipsoids.
    """

    position_m: np.ndarray
    sigma_m: np.ndarray
    covariance_m2: np.ndarray | None = None


class Blocks:
    """Gaussians in blocks of sixteen neighbors, as the kernels read them.

    order: (N,) which Gaussian stands in each row · rows: N rounded up to a multiple of 16
    """

    def __init__(self, position_m: np.ndarray) -> None:
        self.order = spatial_order(position_m)
        self.rows = padded_rows(len(position_m))

    @property
    def count(self) -> int:
        """How many blocks."""
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


class FastSkinning:
    """Poses one avatar again and again, without gradients; colors stay as they are (`fast_learned` for trained ones).

    blocks: what the order of the rows comes from · opacity (rows,), rgb (rows, 3): in that order, float32 · rows beyond
    the avatar have sigma 0 and opacity 0
    """

    def __init__(self, library: Library, avatar: HandAvatar) -> None:
        check_task(library, library.call.jg_skin_task_bytes(), SkinTask)
        self._call = library.call.jg_skin
        self.blocks = Blocks(avatar.position_m)
        self.opacity = self.blocks.in_rows(avatar.opacity)
        self.rgb = self.blocks.in_rows(avatar.rgb)
        self.team = new_team()
        self.task = SkinTask(
            blocks=self.blocks.count, stretch_min=limits.SIGMA_STRETCH_MIN, stretch_max=limits.SIGMA_STRETCH_MAX
        )
        self._arrays = skin_arrays(avatar, self.blocks)
        point(self.task, self._arrays)
        self._keep: tuple[object, ...] = ()

    @property
    def order(self) -> np.ndarray:
        """(N,) which Gaussian of the avatar stands in each row."""
        return self.blocks.order

    @property
    def rows(self) -> int:
        """Of the arrays that a pose is written into."""
        return self.blocks.rows

    def prepare(self, bones: Bones, into: PosedArrays, shift_m: np.ndarray) -> None:
        """Sets the next pose. Positions come out relative to the hand's root, plus `shift_m` (3,).

        InputError names an array that the kernel cannot read or write: `into` needs `rows` rows.
        """
        linear_offset = np.ascontiguousarray(bones.linear_offset, np.float32)
        task, rows, covariance = self.task, self.rows, into.covariance_m2
        task.linear_offset = address(linear_offset, np.float32, "linear_offset", (JOINT_COUNT, 3, 4))
        task.position = address(into.position_m, np.float32, "position_m", (rows, 3), writable=True)
        task.sigma = address(into.sigma_m, np.float32, "sigma_m", (rows,), writable=True)
        task.covariance = (
            None if covariance is None else address(covariance, np.float32, "covariance_m2", (rows, 6), writable=True)
        )
        task.shift = tuple(shift_m)
        task.scale, task.inverse_scale = bones.scale, inverse_scale(bones)
        self._keep = (linear_offset, into)
        self.team.fill(0)

    def run(self) -> None:
        """Poses the avatar; every thread of a team calls it."""
        self._call(self.team.ctypes.data, ctypes.addressof(self.task))


def skin_arrays(avatar: HandAvatar, blocks: Blocks) -> dict[str, np.ndarray]:
    """What the kernel reads of an avatar at rest: fields of SkinTask by name."""
    relative = avatar.position_m.astype(np.float64) - avatar.canonical_joints_m[0]
    rest = np.concatenate([relative, avatar.sigma_m[:, None]], axis=1)
    arrays = {"rest": blocks.blocked(rest)} | blocks.bones(avatar.bone_weights)
    if (axes := ellipsoid_axes(avatar)) is not None:
        arrays["axes"] = blocks.blocked(axes)
    return arrays


def check_task(library: Library, size: int, mirror: type[ctypes.Structure]) -> None:
    """RetryError when the library's structure is not of the size of its mirror."""
    if size != ctypes.sizeof(mirror):
        wanted = f"a {mirror.__name__} of {ctypes.sizeof(mirror)} bytes"
        raise RetryError(f"native library {library.path.name}", wanted=wanted, came=str(size))


def point(task: ctypes.Structure, arrays: dict[str, np.ndarray]) -> None:
    """Lets the task's fields point to arrays, which the caller keeps."""
    for name, array in arrays.items():
        setattr(task, name, array.ctypes.data)


def inverse_scale(bones: Bones) -> float:
    """1 / s_g, finite for a hand without size."""
    return 1.0 / max(bones.scale, float(np.finfo(np.float32).tiny))


def ellipsoid_axes(avatar: HandAvatar) -> np.ndarray | None:
    """(N, 9) float64 the axes of its ellipsoids in the canonical hand, meters, row by row; None for spheres."""
    ellipsoid = None if avatar.learned is None else avatar.learned.ellipsoid
    if ellipsoid is None:
        return None
    scale_m = np.exp(np.log(avatar.sigma_m.astype(np.float64))[:, None] + ellipsoid.log_stretch)
    return (rotations(ellipsoid.quaternion) * scale_m[:, None]).reshape(-1, 9)


def rotations(quaternion: np.ndarray) -> np.ndarray:
    """(N, 3, 3) float64 of quaternions (N, 4) wxyz of any length; none of one that is too short."""
    turn = quaternion.astype(np.float64)
    length = np.linalg.norm(turn, axis=1, keepdims=True)
    none = np.array([1.0, 0.0, 0.0, 0.0])
    w, x, y, z = np.where(length > QUATERNION_MIN, turn / np.maximum(length, QUATERNION_MIN), none).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows).transpose(2, 0, 1)


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
