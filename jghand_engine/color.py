"""sRGB and linear light: the one transfer function of the project (IEC 61966-2-1); its bytes; how alike two images are.

Avatars keep display-referred sRGB and blend in it, but in the light of a scene, which is linear. Formats that want
light (USD's displayColor, glTF's COLOR_0) get it through here. Arrays of any shape; values outside 0..1 follow the same
curve, negative ones its straight part.
"""

from __future__ import annotations

import math

import numpy as np

# below this sRGB value the curve is a straight line of this slope
SRGB_TOE = 0.04045
SRGB_SLOPE = 12.92
SRGB_OFFSET = 0.055
SRGB_EXPONENT = 2.4

# PSNR of equal pictures is infinite, which no mean survives; 8-bit pictures that differ at all are below 84
PSNR_MAX_DB = 100.0


def srgb_to_linear(rgb: np.ndarray) -> np.ndarray:
    """Display-referred sRGB to linear light with the same primaries; keeps dtype and shape."""
    rgb = np.asarray(rgb)
    power = ((np.maximum(rgb, 0) + SRGB_OFFSET) / (1 + SRGB_OFFSET)) ** SRGB_EXPONENT
    return np.where(rgb <= SRGB_TOE, rgb / SRGB_SLOPE, power).astype(rgb.dtype, copy=False)


def linear_to_srgb(rgb: np.ndarray) -> np.ndarray:
    """Linear light to display-referred sRGB; the inverse of `srgb_to_linear`."""
    rgb = np.asarray(rgb)
    power = (1 + SRGB_OFFSET) * np.maximum(rgb, 0) ** (1 / SRGB_EXPONENT) - SRGB_OFFSET
    return np.where(rgb <= SRGB_TOE / SRGB_SLOPE, rgb * SRGB_SLOPE, power).astype(rgb.dtype, copy=False)


def displayed(rgba: np.ndarray) -> np.ndarray:
    """Premultiplied scene-linear (..., 4) as a display shows it: straight colors go through sRGB's curve."""
    alpha = rgba[..., 3:]
    straight = np.divide(rgba[..., :3], alpha, out=np.zeros_like(rgba[..., :3]), where=alpha > 0)
    return np.concatenate([linear_to_srgb(np.clip(straight, 0, 1)) * alpha, alpha], -1)


def to_bytes(values: np.ndarray) -> np.ndarray:
    """Values 0..1 -> uint8, rounded to the nearest step; what lies outside is clipped. Any shape."""
    return np.floor(np.clip(values, 0.0, 1.0) * 255.0 + 0.5).astype(np.uint8)


def decibels(mean_square: float) -> float:
    """Peak signal to noise of values 0..1; capped at PSNR_MAX_DB, which equal pictures have."""
    if mean_square <= 10 ** (-PSNR_MAX_DB / 10):
        return PSNR_MAX_DB
    return -10 * math.log10(mean_square)
