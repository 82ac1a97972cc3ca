"""Rotations in numpy, component last: vectors (..., 3), matrices (..., 3, 3), quaternions wxyz (..., 4)."""

from __future__ import annotations

import numpy as np


def axis_rotation(axis: np.ndarray, angle_rad: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations by `angle_rad` (...) about the unit vectors `axis` (..., 3): Rodrigues."""
    sine, cosine = np.sin(angle_rad)[..., None, None], np.cos(angle_rad)[..., None, None]
    outer = axis[..., :, None] * axis[..., None, :]
    return cosine * np.eye(3) + sine * cross_matrices(axis) + (1 - cosine) * outer


def vector_rotation(vector_rad: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations of rotation vectors (..., 3): about their direction by their length."""
    angle = np.linalg.norm(vector_rad, axis=-1)
    # sinc: also exact for the angle 0, which has no axis
    sine, half = np.sinc(angle / np.pi)[..., None, None], np.sinc(angle / (2 * np.pi))[..., None, None]
    cross = cross_matrices(vector_rad)
    return np.eye(3) + sine * cross + half**2 / 2 * (cross @ cross)


def cross_matrices(vector: np.ndarray) -> np.ndarray:
    """(..., 3) -> (..., 3, 3) with cross_matrices(a) @ b = a x b."""
    x, y, z = np.moveaxis(vector, -1, 0)
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, -1) for row in rows], -2)


def half_turns(axis: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations by pi about the unit vectors `axis` (..., 3): 2 a a^T - I."""
    return 2 * axis[..., :, None] * axis[..., None, :] - np.eye(3)


def minimal_rotation(first: np.ndarray, second: np.ndarray, opposite: np.ndarray) -> np.ndarray:
    """(..., 3, 3) the smallest rotation that turns the unit vectors `first` (..., 3) into `second`. METHOD 2.5.

    opposite: (..., 3, 3) the rotation to use at second = -first, a half turn about an axis perpendicular to `first`.
    Near the antipode 1 / (1 + cos) is replaced by (1 - cos) / sin^2, which does not cancel.
    """
    cosine, axis = (first * second).sum(-1), np.cross(first, second)
    sine2 = (axis * axis).sum(-1)
    behind, usable = cosine < 0, sine2 > 64 * np.finfo(np.float64).eps ** 2
    k = np.where(behind, (1 - cosine) / np.where(usable, sine2, 1.0), 1 / (1 + np.where(behind, 0.0, cosine)))
    outer = k[..., None, None] * axis[..., :, None] * axis[..., None, :]
    rotation = cosine[..., None, None] * np.eye(3) + cross_matrices(axis) + outer
    return np.where((behind & ~usable)[..., None, None], opposite, rotation)


def slerp(first: np.ndarray, second: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Unit vectors (..., n) at `part` (...) of the great circle from `first` to `second`; exact at both ends.

    n is 3 for directions, 4 for quaternions. At second = -first no circle is distinguished: the answer is `first` up to
    the middle and `second` after it.
    """
    cosine = (first * second).sum(-1)
    across = second - cosine[..., None] * first
    sine2 = (across * across).sum(-1)
    # below this the chord is the arc to double precision, and sin / sin would divide round-off by round-off
    near = sine2 < np.finfo(np.float64).eps
    angle = np.arctan2(np.sqrt(np.where(near, 1.0, sine2)), cosine)
    safe = np.where(near, 1.0, np.sin(angle))
    weight_first = np.where(near, 1 - part, np.sin((1 - part) * angle) / safe)
    weight_second = np.where(near, part, np.sin(part * angle) / safe)
    mixed = weight_first[..., None] * first + weight_second[..., None] * second
    length = np.linalg.norm(mixed, axis=-1, keepdims=True)
    # of opposite vectors the chord passes near the origin and its direction is round-off
    has_direction = ~(length <= 1e-6)
    nearest_end = np.where(part[..., None] > 0.5, second, first)
    return np.where(has_direction, mixed / np.where(has_direction, length, 1.0), nearest_end)


def quaternions(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternions wxyz (..., 4) of rotations (..., 3, 3): the best conditioned of the four formulas."""
    m = np.moveaxis(rotation, (-2, -1), (0, 1))
    trace = m[0, 0] + m[1, 1] + m[2, 2]
    # row k is 4 q_k q, so the row with the largest q_k^2 = diagonal / 4 loses nothing
    rows = np.array([
        [1 + trace, m[2, 1] - m[1, 2], m[0, 2] - m[2, 0], m[1, 0] - m[0, 1]],
        [m[2, 1] - m[1, 2], 1 + 2 * m[0, 0] - trace, m[0, 1] + m[1, 0], m[0, 2] + m[2, 0]],
        [m[0, 2] - m[2, 0], m[0, 1] + m[1, 0], 1 + 2 * m[1, 1] - trace, m[1, 2] + m[2, 1]],
        [m[1, 0] - m[0, 1], m[0, 2] + m[2, 0], m[1, 2] + m[2, 1], 1 + 2 * m[2, 2] - trace],
    ])  # fmt: skip
    best = np.argmax(np.stack([rows[k, k] for k in range(4)]), axis=0)
    row = np.take_along_axis(rows, best[None, None], axis=0)[0]
    return np.moveaxis(row / np.linalg.norm(row, axis=0), 0, -1)


def quaternion_rotation(quaternion: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotations of unit quaternions wxyz (..., 4)."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def turns_between(first: np.ndarray, second: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Quaternions (..., 4) at `part` (...) of the shorter way from one to another."""
    return slerp(first, np.where((first * second).sum(-1, keepdims=True) < 0, -second, second), part)


def slerp_rotation(first: np.ndarray, second: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Rotations (..., 3, 3) at `part` (...) of the shortest way between two (..., 3, 3)."""
    a, b = quaternions(first), quaternions(second)
    return quaternion_rotation(turns_between(a, b, part))


def alignment(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(..., 3, 3) rotation R with target about R source, least squares (Kabsch); both (..., n, 3)."""
    u, _, vt = np.linalg.svd(np.swapaxes(target, -1, -2) @ source)
    sign = np.ones((*u.shape[:-2], 3))
    sign[..., 2] = np.sign(np.linalg.det(u @ vt))
    return (u * sign[..., None, :]) @ vt


def unit(vectors: np.ndarray) -> np.ndarray:
    """`vectors` (..., 3) divided by their length; 0 stays 0."""
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
