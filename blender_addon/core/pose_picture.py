# SPDX-License-Identifier: GPL-3.0-or-later
"""A small picture of a pose for the pose library: balls along the bones, seen from the palm's side, without engine."""

from __future__ import annotations

import numpy as np

from . import limits
from .joints import INDEX, MIDDLE, NAMES, PARENTS, PINKY, THUMB, TIPS, WRIST

# where the palm's skin runs besides the bones
_WEB = ((INDEX, MIDDLE), (MIDDLE, 13), (13, PINKY), (THUMB[1], INDEX), (THUMB[0], INDEX))
_LIGHT = np.array([0.0, 0.35, 0.94])
_SKIN = np.array([0.80, 0.58, 0.47])


def pose_picture(joints_m: np.ndarray, size: int = limits.PREVIEW_PX) -> np.ndarray:
    """(21, 3) joints, metres, +y to the fingers and +z out of the palm -> (size, size, 4) RGBA, 0 to 1, top row first.

    All poses are drawn at one scale, so that a fist is smaller than a flat hand.
    """
    picture, depth = np.zeros((size, size, 4)), np.full((size, size), -np.inf)
    scale = size / limits.PREVIEW_WIDTH_M
    left, bottom = np.array(limits.PREVIEW_CENTRE_M) - limits.PREVIEW_WIDTH_M / 2
    for start, end, first, last in _limbs():
        length = np.linalg.norm(joints_m[end] - joints_m[start])
        for part in np.linspace(0, 1, 2 + int(length / limits.PREVIEW_STEP_M)):
            centre = (1 - part) * joints_m[start] + part * joints_m[end]
            at = np.array([(centre[0] - left) * scale, size - (centre[1] - bottom) * scale])
            _ball(picture, depth, at, centre[2] * scale, ((1 - part) * first + part * last) * scale)
    return picture


def _limbs() -> list[tuple[int, int, float, float]]:
    """Pairs of joints with the radius of the skin at each, metres."""
    radius = np.full(len(NAMES), limits.PREVIEW_RADIUS_M)
    radius[WRIST] = 2 * limits.PREVIEW_RADIUS_M
    radius[list(TIPS)] *= limits.PREVIEW_TIP_PART
    bones = [(PARENTS[place], place) for place in range(1, len(NAMES))]
    return [(start, end, float(radius[start]), float(radius[end])) for start, end in (*bones, *_WEB)]


def _ball(picture: np.ndarray, depth: np.ndarray, at: np.ndarray, height: float, radius: float) -> None:
    """Draws one lit ball, in pixels, where it is nearer than what is there."""
    size = len(picture)
    low = np.clip(np.floor(at - radius).astype(int), 0, size)
    high = np.clip(np.ceil(at + radius).astype(int) + 1, 0, size)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]]
    x, y = (columns + 0.5 - at[0]) / radius, -(rows + 0.5 - at[1]) / radius
    inside = x * x + y * y < 1
    z = np.sqrt(np.where(inside, 1 - x * x - y * y, 0.0))
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    nearer = inside & (height + radius * z > depth[window])
    light = np.clip(_LIGHT[0] * x + _LIGHT[1] * y + _LIGHT[2] * z, 0, 1)
    colour = _SKIN * (0.25 + 0.75 * light)[..., None]
    depth[window] = np.where(nearer, height + radius * z, depth[window])
    picture[window] = np.where(nearer[..., None], np.concatenate([colour, np.ones((*x.shape, 1))], -1), picture[window])
