"""A picture that takes time and comes through a lens: which poses and which pinholes are averaged, and how many.

Pictures are averaged as they are blended, premultiplied and display-referred: only then is the mean laid on a
background the mean of the pictures laid on it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from jghand_engine import limits
from jghand_engine.hand.sequence import pose_between
from jghand_engine.render.camera import Camera
from jghand_engine.render.shadow import vogel_disc


@dataclass(frozen=True)
class Shutter:
    """While it is open the hands move. opens_m, closes_m: per hand (21, 3) joints, meters, at its first and its last
    moment, in the frame of the camera; the pose that is rendered is the one in the middle."""

    opens_m: Sequence[np.ndarray]
    closes_m: Sequence[np.ndarray]

    def at(self, part: float, middle_m: Sequence[np.ndarray]) -> list[np.ndarray]:
        """Joints of every hand at `part`, 0..1, of the time."""
        if part < 0.5:
            pairs = zip(self.opens_m, middle_m, strict=True)
            return [pose_between(first, second, 2 * part) for first, second in pairs]
        pairs = zip(middle_m, self.closes_m, strict=True)
        return [pose_between(first, second, 2 * part - 1) for first, second in pairs]


def shutter_at(joints_m: np.ndarray, index: int, open_for: float) -> Shutter | None:
    """The shutter of one frame of a motion (F, 21, 3), open around it for a part, 0..1, of the time between frames.
    None for 0. Before the first frame and after the last one nothing moves."""
    if open_for == 0:
        return None
    before, here, after = (joints_m[np.clip(index + step, 0, len(joints_m) - 1)] for step in (-1, 0, 1))
    return Shutter([pose_between(here, before, open_for / 2)], [pose_between(here, after, open_for / 2)])


def travel_px(shutter: Shutter, middle_m: Sequence[np.ndarray], camera: Camera) -> float:
    """The longest way of a joint on the picture while the shutter is open, as if it went all the time as fast as in its
    faster half: pictures are evenly spread in time. Infinite when it passes the near plane."""
    longest = 0.0
    for moments in zip(shutter.opens_m, middle_m, shutter.closes_m, strict=True):
        pixels, depth = camera.project(np.stack(moments))
        if not (depth > limits.Z_NEAR_M).all():
            return math.inf
        longest = max(longest, 2 * float(np.linalg.norm(np.diff(pixels, axis=0), axis=-1).max()))
    return longest


def motion_error(length_px: float, count: int) -> float:
    """What `count` evenly spread pictures miss of an edge that moves by `length_px`, as a part of its contrast.

    Steps of up to a pixel: the midpoint rule on an edge as steep as splats make it. Longer ones leave stairs of
    1 / count, which are off by half of that.
    """
    step = length_px / count
    if step > 1.0:
        return 0.5 / count
    smooth = step * step / 24 * min(limits.EDGE_CURVATURE, 2 * limits.EDGE_SLOPE / max(length_px, 1e-9))
    return min(smooth, 0.5 / count) if count > 1 else smooth


def focus_error(disc_px: float, count: int) -> float:
    """What `count` pinholes miss of an edge that is out of focus by a disc of `disc_px`, as a part of its contrast."""
    step = disc_px * math.sqrt(math.pi / 4 / count)
    edges = limits.DISC_DISCREPANCY / count**0.75
    smooth = step * step / 24 * limits.EDGE_CURVATURE if step <= 1.0 else math.inf
    return min(edges, smooth)


def disc_of_depths(camera: Camera, nearest_m: float, farthest_m: float) -> float:
    """Diameter of the largest disc that a point between these depths becomes, pixels."""
    lens = camera.lens
    if lens is None:
        return 0.0
    ends = (max(depth_m, limits.Z_NEAR_M) for depth_m in (nearest_m, farthest_m))
    return max(lens.blur_px(max(camera.fx, camera.fy), depth_m) for depth_m in ends)


def motion_count(length_px: float) -> int:
    """The least number of pictures within MOTION_ERROR_MAX."""
    most = math.ceil(0.5 / limits.MOTION_ERROR_MAX)
    enough = (n for n in range(1, most) if motion_error(length_px, n) <= limits.MOTION_ERROR_MAX)
    return next(enough, most)


def focus_count(disc_px: float) -> int:
    """The least number of pinholes within FOCUS_ERROR_MAX."""
    most = math.ceil((limits.DISC_DISCREPANCY / limits.FOCUS_ERROR_MAX) ** (4 / 3))
    return next((n for n in range(1, most) if focus_error(disc_px, n) <= limits.FOCUS_ERROR_MAX), most)


def exposures(
    middle_m: Sequence[np.ndarray], camera: Camera, shutter: Shutter | None, count: int
) -> Iterator[tuple[list[np.ndarray], Camera]]:
    """`count` pictures to be averaged: joints per hand, and a pinhole. Times are evenly spread; the places on the lens
    are a sunflower, in an order that has nothing to do with time."""
    disc = vogel_disc(count) if camera.lens is not None else np.zeros((count, 2))
    radius_m = 0.0 if camera.lens is None else camera.lens.aperture_m / 2
    stride = coprime_near(count)
    for index in range(count):
        x, y = radius_m * disc[index * stride % count]
        joints = list(middle_m) if shutter is None else shutter.at((index + 0.5) / count, middle_m)
        yield joints, camera.through(float(x), float(y))


def coprime_near(count: int) -> int:
    """A stride that visits every one of `count` places, near the golden section of them."""
    stride = max(1, round(count * 0.618))
    while math.gcd(stride, count) != 1:
        stride += 1
    return stride
