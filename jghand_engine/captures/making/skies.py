"""Skies as equirectangular pictures: the standard distributions of luminance, a sun, a ground. Source: CIE S 011:2003.

Their colors are ours: zenith and horizon, and a sun that reddens as it sinks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# rows of the pictures; the columns are twice as many
SKY_ROWS = 128
# how far the sun's light spreads, radians: a disk of a pixel would light by luck
SUN_SPREAD_RAD = np.radians(1.0)
ZENITH_RGB, HORIZON_RGB = np.array([0.55, 0.80, 1.30]), np.array([1.00, 1.00, 0.98])
HIGH_SUN_RGB, LOW_SUN_RGB = np.array([1.05, 1.00, 0.92]), np.array([1.60, 0.90, 0.35])
# elevation below which the sun is red, in parts of a right angle
RED_BELOW = 0.35
GROUND_RGB = np.array([0.28, 0.24, 0.19])


@dataclass(frozen=True)
class Sky:
    """A sky of the standard.

    gradation, circumsolar: its (a, b) and (c, d, e)
    sun_part:               how much of the light on level ground is the sun's, 0..1
    blue:                   of its colors, 0..1
    """

    gradation: tuple[float, float]
    circumsolar: tuple[float, float, float]
    sun_elevation_deg: float
    sun_part: float
    blue: float = 1.0


# the standard's types 1 (overcast), 7 (partly cloudy, bright around the sun), 12 (clear), 13 (clear, polluted air)
_OVERCAST, _PARTLY, _CLEAR, _POLLUTED = (
    ((4.0, -0.70), (0.0, -1.0, 0.0)),
    ((0.0, -1.0), (5.0, -2.5, 0.30)),
    ((-1.0, -0.32), (10.0, -3.0, 0.45)),
    ((-1.0, -0.32), (16.0, -3.0, 0.30)),
)
SKIES = {
    "overcast": Sky(*_OVERCAST, 50.0, 0.0, blue=0.2),
    "partly_cloudy": Sky(*_PARTLY, 40.0, 0.35, blue=0.5),
    "clear_noon": Sky(*_CLEAR, 65.0, 0.75),
    "clear_evening": Sky(*_CLEAR, 12.0, 0.45),
    "hazy_noon": Sky(*_POLLUTED, 55.0, 0.60, blue=0.6),
    "hazy_evening": Sky(*_POLLUTED, 20.0, 0.40, blue=0.7),
}


def sky_radiance(sky: Sky) -> np.ndarray:
    """(SKY_ROWS, 2 SKY_ROWS, 3) float32 radiance whose mean over all directions and colors is 1; +z is up, row 0 there,
    the sun at +x."""
    rows = SKY_ROWS
    height = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)[:, None]
    around = 2 * np.pi * (0.5 - (np.arange(2 * rows) + 0.5) / (2 * rows))[None, :]
    solid_angle = np.broadcast_to(np.cos(height) * (np.pi / rows) ** 2, (rows, 2 * rows))[..., None]
    up = np.broadcast_to(np.sin(height), (rows, 2 * rows))
    elevation = np.radians(sky.sun_elevation_deg)
    from_sun = np.arccos(np.clip(np.cos(height) * np.cos(around) * np.cos(elevation) + up * np.sin(elevation), -1, 1))
    (a, b), (c, d, e) = sky.gradation, sky.circumsolar
    luminance = 1 + a * np.exp(b / np.maximum(up, 1e-3))
    luminance = luminance * (1 + c * (np.exp(d * from_sun) - np.exp(d * np.pi / 2)) + e * np.cos(from_sun) ** 2)
    blend = sky.blue * np.maximum(up, 0)[..., None] ** 0.5
    dome = np.where(up > 0, luminance, 0)[..., None] * (HORIZON_RGB + blend * (ZENITH_RGB - HORIZON_RGB))
    sinking = np.clip(1 - elevation / (RED_BELOW * np.pi), 0, 1)
    disk = np.exp(-0.5 * (from_sun / SUN_SPREAD_RAD) ** 2)[..., None]
    disk = disk * (HIGH_SUN_RGB + sinking * (LOW_SUN_RGB - HIGH_SUN_RGB))
    level = np.maximum(up, 0)[..., None] * solid_angle
    part = sky.sun_part / max(1 - sky.sun_part, 1e-6)
    light = dome + disk * part * (dome * level).sum() / (disk * level).sum()
    ground = GROUND_RGB / np.pi * (light * level).sum((0, 1))
    light = np.where(up[..., None] > 0, light, ground)
    return (light * (4 * np.pi) / (light * solid_angle).sum() * 3).astype(np.float32)
