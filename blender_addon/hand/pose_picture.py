# SPDX-License-Identifier: GPL-3.0-or-later
"""A small picture of a pose for the pose library: balls along the bones, seen from the palm's side, without engine."""

from __future__ import annotations

import numpy as np

from ..core import limits
from ..core.joints import INDEX, MIDDLE, NAMES, PARENTS, PINKY, THUMB, TIPS, WRIST

# where the palm's skin runs besides the bones
_WEB = ((INDEX, MIDDLE), (MIDDLE, 13), (13, PINKY), (THUMB[1], INDEX), (THUMB[0], INDEX))
_LIGHT = np.array([0.0, 0.35, 0.94])
_SKIN = np.array([0.80, 0.58, 0.47])


def pose_picture(joints_m: np.ndarray, size: int = limits.PREVIEW_PX) -> np.ndarray:
    """(21, 3) joints, meters, +y to the fingers and +z out of the palm -> (size, size, 4) RGBA, 0 to 1, top row first.

    All poses are drawn at one scale, so that a fist is smaller than a flat hand.
    """
    picture, depth = np.zeros((size, size, 4)), np.full((size, size), -np.inf)
    scale = size / limits.PREVIEW_WIDTH_M
    left, bottom = np.array(limits.PREVIEW_CENTER_M) - limits.PREVIEW_WIDTH_M / 2
    pixels = np.array(joints_m)
    pixels[:, 0], pixels[:, 1] = (pixels[:, 0] - left) * scale, size - (pixels[:, 1] - bottom) * scale
    pixels[:, 2] *= scale
    for start, end, first, last in _limbs():
        length = np.linalg.norm(joints_m[end] - joints_m[start])
        parts = np.linspace(0, 1, 2 + int(length / limits.PREVIEW_STEP_M))[:, None]
        centers = (1 - parts) * pixels[start] + parts * pixels[end]
        radii = ((1 - parts) * first + parts * last) * scale
        _limb(picture, depth, centers, radii[:, 0])
    return picture


def _limbs() -> list[tuple[int, int, float, float]]:
    """Pairs of joints with the radius of the skin at each, meters."""
    radius = np.full(len(NAMES), limits.PREVIEW_RADIUS_M)
    radius[WRIST] = 2 * limits.PREVIEW_RADIUS_M
    radius[list(TIPS)] *= limits.PREVIEW_TIP_PART
    bones = [(PARENTS[place], place) for place in range(1, len(NAMES))]
    return [(start, end, float(radius[start]), float(radius[end])) for start, end in (*bones, *_WEB)]


def _limb(picture: np.ndarray, depth: np.ndarray, centers: np.ndarray, radii: np.ndarray) -> None:
    """Draws lit balls, (N, 3) and (N,) pixels, where they are nearer than each other and than what is there."""
    size = len(picture)
    low = np.clip(np.floor((centers[:, :2] - radii[:, None]).min(0)).astype(int), 0, size)
    high = np.clip(np.ceil((centers[:, :2] + radii[:, None]).max(0)).astype(int) + 1, 0, size)
    rows, columns = np.mgrid[low[1] : high[1], low[0] : high[0]] + 0.5
    radius = radii[:, None, None]
    x, y = (columns - centers[:, 0, None, None]) / radius, (centers[:, 1, None, None] - rows) / radius
    z = np.sqrt(np.maximum(1 - x * x - y * y, 0.0))
    height = np.where(z > 0, centers[:, 2, None, None] + radius * z, -np.inf)
    nearest = height.argmax(0)[None]
    x, y, z, height = (np.take_along_axis(values, nearest, 0)[0] for values in (x, y, z, height))
    window = (slice(low[1], high[1]), slice(low[0], high[0]))
    nearer = height > depth[window]
    light = np.clip(_LIGHT[0] * x + _LIGHT[1] * y + _LIGHT[2] * z, 0, 1)
    color = _SKIN * (0.25 + 0.75 * light)[..., None]
    depth[window] = np.where(nearer, height, depth[window])
    picture[window] = np.where(nearer[..., None], np.concatenate([color, np.ones((*x.shape, 1))], -1), picture[window])
