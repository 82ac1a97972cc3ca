# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's lights as the engine's lamps: radiometric, scene-linear Rec.709, meters, in the axes of the engine.

What a watt is was measured in Cycles on a white card, light by light; tests/blender/test_lamps.py measures it again.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .view import BLOCKERS, EVERYTHING, LIGHT_FROM_WORLD, RECEIVERS, Picked

# as many light each hand: the engine's own number, and it finds the brightest of those that are sent
LAMPS_LIT = 32
# the engine takes 256, and a world brings a few of its own
LAMPS_SENT = 240
# an area smaller than that is a point anyway, and its radiance grows beyond any number
SIZE_MIN_M = 1e-3


@dataclass(frozen=True)
class BlenderLight:
    """A light as Blender has it; lengths in units of the scene.

    kind:          "SUN", "POINT", "SPOT" or "AREA"
    matrix:        (4, 4) of its object in the world, with scale
    power:         W, of a sun W/m2; it lights nothing at 0 and below
    color:         (3,) what the power is multiplied with, linear Rec.709: color, temperature, nodes
    exposure:      stops
    is_normalized: whether power is that of the whole lamp, whatever its size
    radius:        of point and spot
    is_soft:       whether its light stays finite within the radius
    angle:         of a sun, across
    cone:          of a spot, across
    blend:         part of the cone over which it fades
    size:          (2,) of an area, before the object's scale
    is_ellipse:    whether an area is one
    spread:        of an area, across
    has_shadow:    whether what it lights shades itself
    blockers:      which things throw its shadows
    receivers:     which hands it lights
    matt, gloss:   factors of the light that skin scatters and of that which it mirrors
    """

    kind: str
    matrix: np.ndarray
    power: float
    color: np.ndarray
    exposure: float = 0.0
    is_normalized: bool = True
    radius: float = 0.0
    is_soft: bool = True
    angle: float = 0.0
    cone: float = math.pi
    blend: float = 0.0
    size: tuple[float, float] = (0.0, 0.0)
    is_ellipse: bool = False
    spread: float = math.pi
    has_shadow: bool = True
    matt: float = 1.0
    gloss: float = 1.0
    blockers: Picked = EVERYTHING
    receivers: Picked = EVERYTHING


def lamps_of(light: BlenderLight, unit_m: float) -> list[dict[str, Any]]:
    """The lamps of a light, as the engine reads them: one; two where skin scatters and mirrors different parts of it;
    none where it lights nothing. unit_m: meters per unit of the scene."""
    turned = LIGHT_FROM_WORLD @ np.asarray(light.matrix, np.float64)
    scale = np.linalg.norm(turned[:3, :3], axis=0)
    sides = turned[:3, :3] / np.maximum(scale, 1e-30)
    match light.kind:
        case "SUN":
            shape = _sun(light, sides, scale)
        case "SPOT":
            shape = _spot(light, sides, scale, unit_m)
        case "AREA":
            shape = _area(light, sides, scale, unit_m)
        case _:
            shape = _point(light, unit_m)
    if shape is None:
        return []
    strength, lamp = shape
    rgb = np.maximum(light.color, 0.0) * (light.power * 2.0**light.exposure * strength)
    if not (np.isfinite(rgb).all() and np.isfinite(turned).all() and rgb.max() > 0):
        return []
    place = {"place_m": (turned[:3, 3] * unit_m).tolist()}
    lamp = {"kind": light.kind.lower(), "has_shadow": light.has_shadow, **place, **lamp}
    picks = {BLOCKERS: light.blockers, RECEIVERS: light.receivers}
    lamp |= {name: picked for name, picked in picks.items() if picked != EVERYTHING}
    parts: list[tuple[float, dict[str, bool]]] = [(light.matt, {})]
    if light.matt != light.gloss:
        parts = [(light.matt, {"on_gloss": False}), (light.gloss, {"on_matt": False})]
    return [{**lamp, "rgb": (rgb * factor).tolist(), **counts} for factor, counts in parts if factor > 0]


def brightest(lamps: list[dict[str, Any]], lit_m: Sequence[np.ndarray]) -> list[dict[str, Any]]:
    """As many lamps as are sent: those that light a place, one (3,) for each lamp in Blender's axes, most if it is in
    their beams."""
    if len(lamps) <= LAMPS_SENT:
        return lamps

    def light(number: int) -> float:
        lamp, middle = lamps[number], LIGHT_FROM_WORLD[:3, :3] @ lit_m[number]
        if lamp["kind"] == "sun":
            return sum(lamp["rgb"])
        distance2 = float(np.square(middle - lamp["place_m"]).sum())
        return sum(lamp["rgb"]) * math.prod(lamp.get("size_m", (1.0,))) / max(distance2, 1e-6)

    return [lamps[number] for number in sorted(range(len(lamps)), key=light, reverse=True)[:LAMPS_SENT]]


# of a light of power 1: what a lamp of its kind has for it, and the lamp's other fields
_Shape = tuple[float, dict[str, Any]]


def _sun(light: BlenderLight, sides: np.ndarray, scale: np.ndarray) -> _Shape | None:
    if scale[2] == 0:
        return None
    # the disk's projected solid angle; one without a size is as it says
    strength = 1.0 if light.is_normalized or light.angle == 0 else math.pi * math.sin(light.angle / 2) ** 2
    return strength, {"place_m": sides[:, 2].tolist(), "angle_rad": light.angle}


def _point(light: BlenderLight, unit_m: float) -> _Shape:
    """The scale of its object is nothing to it."""
    strength = 1 / (4 * math.pi)
    if not light.is_normalized:
        strength = light.radius**2 if light.radius > 0 else 1 / math.pi
    # Blender counts in its unit as if that were the meter
    return strength * unit_m**2, {"radius_m": light.radius * unit_m, "is_soft": light.is_soft}


def _spot(light: BlenderLight, sides: np.ndarray, scale: np.ndarray, unit_m: float) -> _Shape | None:
    if scale.min() == 0 or light.cone <= 0:
        return None
    strength, lamp = _point(light, unit_m)
    # the object's scale makes the cone wider; an elliptical one is lit as the round one of the same size
    wider = math.sqrt(scale[0] * scale[1]) / scale[2]
    edge = math.cos(light.cone / 2)
    angles = [math.acos(edge), math.acos(min(edge + (1 - edge) * light.blend, 1.0))]
    outer, inner = (math.atan2(wider * math.sin(angle), math.cos(angle)) for angle in angles)
    blend = (math.cos(inner) - math.cos(outer)) / (1 - math.cos(outer))
    return strength, {**lamp, "axis": (-sides[:, 2]).tolist(), "cone_rad": 2 * outer, "blend": blend}


def _area(light: BlenderLight, sides: np.ndarray, scale: np.ndarray, unit_m: float) -> _Shape | None:
    size = np.asarray(light.size) * scale[:2]
    if scale[2] == 0 or size.min() <= 0:
        return None
    area = size[0] * size[1] * (math.pi / 4 if light.is_ellipse else 1.0)
    size_m = np.maximum(size * unit_m, SIZE_MIN_M)
    # its light stays where its size does not
    strength = 1 / math.pi / (area if light.is_normalized else 1.0) * float(np.prod(size * unit_m / size_m))
    return strength, {
        "axis": (-sides[:, 2]).tolist(),
        "side": sides[:, 0].tolist(),
        "size_m": size_m.tolist(),
        "is_ellipse": light.is_ellipse,
        "spread_rad": light.spread,
    }
