"""Joints and bones drawn over a picture, to see at a glance whether they belong to it."""

from __future__ import annotations

import numpy as np
from PIL import Image, ImageDraw
from scipy import ndimage

from jghand_engine.captures.pictures_in import read_picture
from jghand_engine.captures.projection import joint_pixels, joints_on_mask
from jghand_engine.captures.sample import Sample, load_picture
from jghand_engine.hand.joints import PARENTS

# overlay pictures: enlargement, and how far outside of the picture lines are still drawn, px
OVERLAY_ZOOM = 2
OVERLAY_REACH_PX = 20_000

# thumb to pinky, sRGB bytes: apart for most color-blind eyes, and none of them skin
_FINGER_COLORS = ((230, 159, 0), (86, 180, 233), (0, 158, 115), (240, 228, 66), (204, 121, 167))
_WRIST, _OUTLINE, _OFF, _GRAY = (255, 255, 255), (0, 255, 255), (255, 0, 0), 96


def overlay(sample: Sample) -> np.ndarray:
    """(h, w, 3) uint8: the picture (on gray where it is transparent), the mask's outline in cyan, bones by finger,
    joints; a red ring around joints that miss the mask. Enlarged, so that lines are thin."""
    zoom = OVERLAY_ZOOM
    outlined: np.ndarray = load_picture(sample).mask >= 0.5
    stored = read_picture(sample.picture)
    height, width = stored.shape[:2]
    image = Image.fromarray(_on_gray(stored)).resize((width * zoom, height * zoom), Image.Resampling.LANCZOS)
    pixels = np.array(image)
    hand = np.repeat(np.repeat(outlined, zoom, axis=0), zoom, axis=1)
    pixels[hand & np.logical_not(ndimage.binary_erosion(hand))] = _OUTLINE
    image = Image.fromarray(pixels)
    draw = ImageDraw.Draw(image)
    points = joint_pixels(sample.camera, sample.joints_m) * zoom - 0.5
    # NaN is not smaller either
    drawable = [bool((np.abs(point) < OVERLAY_REACH_PX).all()) for point in points]
    for joint in range(1, len(points)):
        if drawable[joint] and drawable[PARENTS[joint]]:
            draw.line([*points[PARENTS[joint]], *points[joint]], fill=_color(joint), width=2 * zoom)
    on = joints_on_mask(sample.camera, sample.joints_m, outlined)
    for joint in (joint for joint, wanted in enumerate(drawable) if wanted):
        draw.circle(tuple(points[joint]), 2.5 * zoom, fill=_color(joint), outline=(0, 0, 0))
        if on[joint] == 0:
            draw.circle(tuple(points[joint]), 5 * zoom, outline=_OFF, width=zoom)
    return np.asarray(image)


def _on_gray(stored: np.ndarray) -> np.ndarray:
    if stored.shape[2] == 3:
        return stored
    alpha = stored[..., 3:].astype(np.float32) / 255.0
    return (stored[..., :3] * alpha + _GRAY * (1 - alpha) + 0.5).astype(np.uint8)


def _color(joint: int) -> tuple[int, int, int]:
    return _FINGER_COLORS[(joint - 1) % 5] if joint else _WRIST
