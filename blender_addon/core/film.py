# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's picture as Blender's passes: display colors to scene-linear, depth in Blender's unit, rows from the
bottom. Does not use bpy. Source: BLENDER 7.3 (what must be written where), 8.1.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

# depth of nothing, Blender units: what Blender's own engines write, and Z combine expects
NOTHING_DEPTH = 1e10


def scene_linear(rgba: np.ndarray) -> np.ndarray:
    """(H, W, 4) premultiplied, display-referred sRGB -> the same premultiplied in linear light, float32.

    The curve is that of straight color, so alpha is divided out and multiplied in again.
    """
    out = np.zeros(rgba.shape, np.float32)
    box = covered(rgba[..., 3])
    values, alpha = rgba[box], rgba[box][..., 3]
    divisor = np.where(alpha > 0, alpha, np.float32(1))
    for channel in range(3):  # one after the other: small arrays stay in the cache
        out[box][..., channel] = linear_of(values[..., channel] / divisor) * alpha
    out[box][..., 3] = alpha
    return out


def over(rgba: np.ndarray, background: Sequence[float]) -> np.ndarray:
    """A premultiplied linear picture on an opaque color, linear too."""
    out = np.empty_like(rgba)
    out[...] = (*background, 1)
    box = covered(rgba[..., 3])
    values, behind = rgba[box], 1 - rgba[box][..., 3]
    for channel, color in enumerate(background):
        out[box][..., channel] = values[..., channel] + behind * np.float32(color)
    return out


def depth_units(depth_m: np.ndarray, unit_m: float) -> np.ndarray:
    """(H, W) meters along the view axis, 0 = nothing -> Blender units, with what a Z combine takes for nothing."""
    return np.where(depth_m > 0, depth_m / np.float32(unit_m), np.float32(NOTHING_DEPTH)).astype(np.float32)


def from_bottom(values: np.ndarray) -> np.ndarray:
    """(H, W, …) with row 0 at the top -> flat float32 as a pass of Blender takes it."""
    return np.ascontiguousarray(values[::-1], np.float32).ravel()


def covered(alpha: np.ndarray) -> tuple[slice, slice]:
    """The rows and columns outside of which a picture (H, W) is empty."""
    sides = []
    for axis in (1, 0):
        places = np.flatnonzero(alpha.any(axis))
        sides.append(slice(places[0], places[-1] + 1) if len(places) else slice(0, 0))
    return sides[0], sides[1]


def linear_of(srgb: np.ndarray) -> np.ndarray:
    """Display-referred sRGB -> linear light, float32 of any shape (IEC 61966-2-1)."""
    curve = ((np.maximum(srgb, 0) + np.float32(0.055)) / np.float32(1.055)) ** np.float32(2.4)
    return np.where(srgb <= np.float32(0.04045), srgb / np.float32(12.92), curve)
