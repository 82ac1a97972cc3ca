"""Maps beside the color of an image: normals of its depth, and which hand or bone a pixel shows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from jghand_engine.native import contract
from jghand_engine.render.camera import Camera

# ---- normals --------------------------------------------------------------------------------------------------------


def surface_normals(depth_m: np.ndarray, camera: Camera) -> np.ndarray:
    """Unit normals (H, W, 3) towards the camera, in its axes, of a depth map (H, W), meters, 0 where there is none;
    there they are 0.

    From the smaller one-sided depth difference along each axis, over SHADOW_NORMAL_REACH_M: splats are bumpy. The same
    as `learn.shadow` and the shadow's kernel have it.
    """
    valid = depth_m > 0
    depth_m = np.where(valid, depth_m, np.float32(1))
    # how far apart rays are that are 1 apart at depth 1
    spread = np.ones_like(depth_m) if camera.orthographic else depth_m
    y = ((np.arange(camera.height) + 0.5 - camera.cy) / camera.fy).astype(depth_m.dtype)
    x = ((np.arange(camera.width) + 0.5 - camera.cx) / camera.fx).astype(depth_m.dtype)
    points = np.stack([x * spread, y[:, None] * spread, depth_m], -1)
    low, high = contract.SHADOW_RADIUS_MIN_PX, contract.SHADOW_RADIUS_MAX_PX
    tangents = []
    for axis, focal in ((0, camera.fy), (1, camera.fx)):
        step_px = np.clip(np.float32(focal * contract.SHADOW_NORMAL_REACH_M) / spread, low, high)
        tangents.append(_tangent(points, valid, np.rint(step_px).astype(np.int64), axis))
    normal = np.cross(*tangents)
    square = np.maximum((normal * normal).sum(-1, keepdims=True), contract.SHADOW_NORMAL_MIN2)
    normal /= np.sqrt(square)
    away = normal[..., 2:] if camera.orthographic else (normal * points).sum(-1, keepdims=True)
    return np.where(valid[..., None], np.where(away > 0, -normal, normal), np.float32(0))


def _tangent(points: np.ndarray, valid: np.ndarray, step: np.ndarray, axis: int) -> np.ndarray:
    """Difference of `points` over `step` (H, W) pixels along an image axis (0 rows, 1 columns); the image axis where a
    pixel has no neighbor."""
    (next_points, ahead), (last_points, behind) = (_neighbor(points, valid, sign * step, axis) for sign in (1, -1))
    forward, backward = next_points - points, points - last_points
    size_f, size_b = np.abs(forward[..., 2]), np.abs(backward[..., 2])
    floor = contract.SHADOW_AGREE * np.minimum(size_f, size_b) + contract.SHADOW_AGREE_FLOOR_M
    agree = ahead & behind & (np.abs(size_f - size_b) < floor)
    use_forward = ahead & (~behind | (size_f < size_b))
    tangent = np.where(use_forward[..., None], forward, backward)
    tangent = np.where(agree[..., None], np.float32(0.5) * (forward + backward), tangent)
    along = np.eye(3, dtype=points.dtype)[1 - axis]
    return np.where((ahead | behind)[..., None], tangent, along)


def _neighbor(points: np.ndarray, valid: np.ndarray, step: np.ndarray, axis: int) -> tuple[np.ndarray, np.ndarray]:
    """`points` (H, W, 3) at index + step along an axis, and whether there is one."""
    rows, columns = np.indices(valid.shape)
    wanted = (rows if axis == 0 else columns) + step
    inside = np.clip(wanted, 0, valid.shape[axis] - 1)
    place = (inside, columns) if axis == 0 else (rows, inside)
    return points[place], valid[place] & (wanted == inside) & valid


# ---- hands and bones ------------------------------------------------------------------------------------------------


def owners(counts: Sequence[int]) -> np.ndarray:
    """(N,) which hand each row is of, for hands of so many rows."""
    return np.repeat(np.arange(len(counts)), counts)


def part_colors(numbers: np.ndarray, first: int) -> np.ndarray:
    """(N, 3) float32 colors: 1 in the channel of the row's number, among three numbers from `first` on."""
    return (numbers[:, None] == np.arange(first, first + 3)).astype(np.float32)


def hand_weights(hands: int, coverage: Callable[[int], np.ndarray]) -> np.ndarray:
    """(H, W, hands) float32 from `coverage(first)` (H, W, 3) of the hands `first` and the next two."""
    planes = [coverage(first) for first in range(0, hands, 3)]
    return np.concatenate(planes, -1)[..., :hands].astype(np.float32)


def heaviest_part(parts: int, coverage: Callable[[int], np.ndarray]) -> np.ndarray:
    """(H, W) uint8 number of the part that covers most of the pixel, 0 where hardly anything does, from
    `coverage(first)` (H, W, 3) of the parts `first` and the next two."""
    heaviest, total, numbers = np.float32(0), np.float32(0), np.uint8(0)
    for first in range(1, parts + 1, 3):
        covered = coverage(first)
        total = total + covered.sum(-1)
        here = covered.argmax(-1)
        most = np.take_along_axis(covered, here[..., None], -1)[..., 0]
        numbers = np.where(most > heaviest, (first + here).astype(np.uint8), numbers)
        heaviest = np.maximum(heaviest, most)
    return np.where(total > contract.DEPTH_ALPHA_MIN, numbers, 0).astype(np.uint8)
