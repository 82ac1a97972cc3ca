"""Which part of an image hands can touch, from bones and boxes alone, before any skin."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.image import Box

# the box stands at multiples of this, px: tiles stay where they were, and buffers are seldom made anew
CROP_STEP_PX = 64
NOWHERE = Box(0, 0, 0, 0)


def hand_box(
    joints_m: Sequence[np.ndarray], bones: Sequence[Bones], hands: Sequence[HandFacts], camera: Camera, alpha_min: float
) -> Box:
    """The rectangle that may be touched: NOWHERE for hands behind the camera or beside the image, all of it where that
    is not known."""
    return views_box(((*one, camera) for one in zip(joints_m, bones, hands, strict=True)), alpha_min)


def views_box(views: Iterable[tuple[np.ndarray, Bones, HandFacts, Camera]], alpha_min: float) -> Box:
    """As `hand_box`, around hands each of which has a camera of its own: those of one size of image. What passes the
    image between two views is in it."""
    # from, to: of columns and rows
    found, width, height = [math.inf, -math.inf, math.inf, -math.inf], 0, 0
    views, cut = list(views), math.sqrt(2 * math.log(1 / alpha_min) * contract.BLUR_PX2)
    # hands share a low pass, `Backend.draw`: whichever of theirs it is
    low_pass_m = cut * max((hand.avatar.pixel_m * own.scale for _, own, hand, _ in views), default=0.0)
    for joints, own, hand, camera in views:
        rotation, offset_m = camera.camera_from_world[:3, :3], camera.camera_from_world[:3, 3]
        width, height = camera.width, camera.height
        corners = hand.corners_m(own.maps)
        if not len(corners):
            continue
        points = corners @ rotation.T + (rotation @ joints[0] + offset_m)
        (splat_m, offset_by_m), depth_m = hand.reach_m(own, alpha_min), points[:, 2]
        splat_m = math.hypot(splat_m, low_pass_m)
        reach_m = splat_m + offset_by_m
        nearest_m, farthest_m = float(depth_m.min()) - reach_m, float(depth_m.max()) + reach_m
        # nothing behind the near plane is drawn
        if farthest_m <= contract.Z_NEAR_M and not own.flags:
            continue
        # a flagged hand stretches its skin beyond what is known
        if own.flags or not (nearest_m > -math.inf and farthest_m < math.inf):
            return Box(0, 0, width, height)
        low_pass_px = cut + 1
        if nearest_m <= contract.Z_NEAR_M:
            if camera.orthographic:
                return Box(0, 0, width, height)
            lows, highs = points[:, :2].min(0) - offset_by_m, points[:, :2].max(0) + offset_by_m
            for axis, low, high in zip((0, 2), lows.tolist(), highs.tolist(), strict=True):
                focal, center = (camera.fy, camera.cy) if axis else (camera.fx, camera.cx)
                start, end = _beyond(low, splat_m, farthest_m), _beyond(-high, splat_m, farthest_m)
                found[axis] = min(found[axis], focal * start + center - low_pass_px)
                found[axis + 1] = max(found[axis + 1], center - focal * end + low_pass_px)
            continue
        slope = points[:, :2] if camera.orthographic else points[:, :2] / depth_m[:, None]
        for axis, low, high in zip((0, 2), slope.min(0).tolist(), slope.max(0).tolist(), strict=True):
            focal, center = (camera.fy, camera.cy) if axis else (camera.fx, camera.cx)
            # a ball of radius r at depth z covers r (1 + tan) / (z - r) of the plane at depth 1, and the low pass comes
            # on top: a Gaussian of opacity 1 is cut where its exponent is ln(1 / alpha_min)
            wide = 1.0 if camera.orthographic else (1 + max(abs(low), abs(high))) / nearest_m
            margin = focal * reach_m * wide + low_pass_px
            found[axis] = min(found[axis], focal * low + center - margin)
            found[axis + 1] = max(found[axis + 1], focal * high + center + margin)
    left, right = _on_grid(found[0], found[1], width)
    top, bottom = _on_grid(found[2], found[3], height)
    return Box(left, top, right - left, bottom - top) if left < right and top < bottom else NOWHERE


def _beyond(aside_m: float, splat_m: float, farthest_m: float) -> float:
    """From where on the plane at depth 1 splats can be seen whose centers are at least `aside_m` beside the axis, from
    the near plane to the farthest depth: one at x, z begins at (x - r (1 + x / z)) / z or farther out."""
    clear_m = aside_m * (1 - splat_m / contract.Z_NEAR_M) - splat_m
    return clear_m / farthest_m if aside_m > 0 and splat_m < contract.Z_NEAR_M and clear_m > 0 else -math.inf


def _on_grid(low: float, high: float, size: int) -> tuple[int, int]:
    """From `low` to `high`, pixels, widened to the grid and cut to the image; empty outside of it."""
    if not (high > 0 and low < size):
        return 0, 0
    first = math.floor(max(low, 0.0) / CROP_STEP_PX) * CROP_STEP_PX
    return first, min(math.ceil(min(high, size) / CROP_STEP_PX) * CROP_STEP_PX, size)
