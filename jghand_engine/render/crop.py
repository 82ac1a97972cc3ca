"""Which part of an image hands can touch, from bones and boxes alone, before any skin."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jghand_engine.hand.skeleton import Bones
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera
from jghand_engine.render.gate import extent_px
from jghand_engine.render.hand_facts import HandFacts
from jghand_engine.render.image import Box

# the box stands at multiples of this, px: tiles stay where they were, and buffers are seldom made anew
CROP_STEP_PX = 64
NOWHERE = Box(0, 0, 0, 0)


class View:
    """A hand in a pose before a camera. joints_m: (21, 3) world meters; the first is where its root is

    lows_m, highs_m: along the axes of the camera, of points whose hull holds every skinned place; infinite without any
    lows, highs:     the same of x / z and y / z, of parallel rays of x and y
    splat_m:         how far a Gaussian reaches from its center in an image with this cut-off
    offset_by_m:     how far its center may be from its skinned place
    nearest_m:       depth of the nearest joint
    extent_px:       the longer side of the box around the hand
    """

    def __init__(self, joints_m: np.ndarray, bones: Bones, hand: HandFacts, camera: Camera, alpha_min: float) -> None:
        self.bones, self.hand, self.camera = bones, hand, camera
        found = hand.before(camera, joints_m, bones)
        self.lows_m, self.highs_m, self.lows, self.highs = found[:3], found[3:6], found[6:8], found[8:10]
        stretch, self.nearest_m, wide, high = found[10:]
        self.splat_m, self.offset_by_m = hand.reach_m(bones.scale, stretch, alpha_min)
        self.extent_px = extent_px(max(camera.fx * wide, camera.fy * high), self.nearest_m, camera)


def seen_hands(views: Sequence[View], alpha_min: float) -> tuple[Box, tuple[bool, ...]]:
    """The rectangle of an image that hands may touch, around that of each as of `views_box`, and whether each does."""
    pixel_m = _coarsest_m(views)
    boxes = [views_box([view], alpha_min, pixel_m) for view in views]
    found = [box for box in boxes if box.width]
    seen = tuple(bool(box.width) for box in boxes)
    if not found:
        return NOWHERE, seen
    left, top = min(box.left for box in found), min(box.top for box in found)
    right, bottom = max(box.left + box.width for box in found), max(box.top + box.height for box in found)
    return Box(left, top, right - left, bottom - top), seen


def views_box(views: Sequence[View], alpha_min: float, pixel_m: float = 0.0) -> Box:
    """The rectangle that hands may touch, each before a camera of its own, all of one size of image: NOWHERE for hands
    behind the camera or beside the image, all of it where that is not known. What passes the image between two views is
    in it. pixel_m: of other hands in the image, as of `_coarsest_m`"""
    # from, to: of columns and rows
    found, width, height = [math.inf, -math.inf, math.inf, -math.inf], 0, 0
    cut = math.sqrt(2 * math.log(1 / alpha_min) * contract.BLUR_PX2)
    low_pass_m = cut * max(pixel_m, _coarsest_m(views))
    for view in views:
        camera, flags = view.camera, view.bones.flags
        width, height = camera.width, camera.height
        if view.lows_m[2] > view.highs_m[2]:
            continue
        splat_m, offset_by_m = math.hypot(view.splat_m, low_pass_m), view.offset_by_m
        reach_m = splat_m + offset_by_m
        nearest_m, farthest_m = view.lows_m[2] - reach_m, view.highs_m[2] + reach_m
        # nothing behind the near plane is drawn
        if farthest_m <= contract.Z_NEAR_M and not flags:
            continue
        # a flagged hand stretches its skin beyond what is known
        if flags or not (nearest_m > -math.inf and farthest_m < math.inf):
            return Box(0, 0, width, height)
        low_pass_px = cut + 1
        if nearest_m <= contract.Z_NEAR_M:
            if camera.orthographic:
                return Box(0, 0, width, height)
            for axis, aside_m, far_aside_m in zip((0, 2), view.lows_m[:2], view.highs_m[:2], strict=True):
                low, high = aside_m - offset_by_m, far_aside_m + offset_by_m
                focal, center = (camera.fy, camera.cy) if axis else (camera.fx, camera.cx)
                start, end = _beyond(low, splat_m, farthest_m), _beyond(-high, splat_m, farthest_m)
                found[axis] = min(found[axis], focal * start + center - low_pass_px)
                found[axis + 1] = max(found[axis + 1], center - focal * end + low_pass_px)
            continue
        for axis, low, high in zip((0, 2), view.lows, view.highs, strict=True):
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


def _coarsest_m(views: Sequence[View]) -> float:
    """The largest pixel of pictures that one of the hands was learned from, meters: hands share a low pass
    (`Backend.draw`), whichever of theirs it is."""
    return max((view.hand.avatar.pixel_m * view.bones.scale for view in views), default=0.0)


def _beyond(aside_m: float, splat_m: float, farthest_m: float) -> float:
    """From where on the plane at depth 1 splats can be seen whose centers are at least `aside_m` beside the axis, from
    the near plane to the farthest depth: one at x, z begins at (x - r (1 + x / z)) / z or farther out."""
    clear_m = aside_m * (1 - splat_m / contract.Z_NEAR_M) - splat_m
    return clear_m / farthest_m if splat_m < contract.Z_NEAR_M and clear_m > 0 else -math.inf


def _on_grid(low: float, high: float, size: int) -> tuple[int, int]:
    """From `low` to `high`, pixels, widened to the grid and cut to the image; empty outside of it."""
    if not (high > 0 and low < size):
        return 0, 0
    first = math.floor(max(low, 0.0) / CROP_STEP_PX) * CROP_STEP_PX
    return first, min(math.ceil(min(high, size) / CROP_STEP_PX) * CROP_STEP_PX, size)
