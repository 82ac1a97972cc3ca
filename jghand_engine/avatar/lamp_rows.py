"""Which lamps of a scene matter to a hand, and whose shadows do, as the kernel takes them (native/scene_light.cpp).

Nothing is switched: what goes below its limit has faded by then.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.cast_task import posed_joints_m
from jghand_engine.avatar.scene_light import Lamp, SceneLight
from jghand_engine.hand.joints import PARENTS
from jghand_engine.native.scene_light_task import LAMP_NUMBERS, NUMBER, LampKind

# lamps of a scene that are drawn, of which each casts its own shadow
LAMPS_MAX = 32
# an area that is larger, by the sine of its half angle, is four lamps
WHOLE_SINE_MAX = 0.12
# ... and they are drawn apart from four in one place up to that many times larger ones
APART_SINE = 1.25
# where lamps are compared: at the ends of the bones and at these parts of their lengths, a few centimeters apart
BONE_PARTS = (1 / 3, 2 / 3)
# radii of a narrow area, or of a part of it, that its beam is wider by: where beams of four parts meet is light, too
BEAM_RADII = 1.7
# floors against division by zero
DISTANCE2_MIN_M2, COSINE_MIN, TINY = 1e-12, 1e-4, float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Limits:
    """Parts of all light at a hand below which something is left out; from twice of that on it is complete. 0 draws it
    always, infinity never.

    lamp:        light of a lamp
    lamp_shadow: light of a lamp whose shadow is
    world_shadow: what skin hides of the world and throws back itself
    """

    lamp: float = 0.002
    lamp_shadow: float = 0.005
    world_shadow: float = 0.02


LIMITS = Limits()


def fade(part: np.ndarray, limit: float) -> np.ndarray:
    """How much is drawn of what is such a part of the light, 0..1."""
    return np.clip(part / max(limit, TINY) - 1, 0, 1)


def compared_at(linear_offset: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """(61, 3) points of a hand at which lamps are compared, root-relative. linear_offset: (21, 3, 4) of its bones ·
    joints_m: (21, 3) of the canonical hand, root-relative"""
    ends = posed_joints_m(linear_offset, joints_m)
    starts = ends[list(PARENTS[1:])]
    return np.concatenate([ends, *(starts + part * (ends[1:] - starts) for part in BONE_PARTS)])


def light_shares(light: SceneLight, root_m: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(lamps + 1,) part of all light that comes from each lamp and, the last, from the world, at that of the hand's
    points where it is the largest. root_m: (3,) of the hand · points_m: (K, 3) of it, root-relative"""
    world = 0.0 if light.world is None else float(light.world.terms.mean_irradiance.sum())
    each = np.full((len(light.lamps) + 1, len(points_m)), world)
    each[:-1] = irradiance_at(_widened(_rows(light, root_m), points_m.mean(0)), points_m).sum(-1)
    return (each / np.maximum(each.sum(0), TINY)).max(1)


def lamp_weights(shares: np.ndarray, limits: Limits) -> np.ndarray:
    """(lamps,) how much of each lamp is drawn, 0..1. shares: see `light_shares`"""
    weight = fade(shares[:-1], limits.lamp)
    weight[np.argsort(-shares[:-1], kind="stable")[LAMPS_MAX:]] = 0
    return weight


def world_shade(shares: np.ndarray, bounce: np.ndarray, limits: Limits) -> tuple[float, float]:
    """How much is drawn of the shadow in the world and of what skin throws onto skin, 0..1, and which part of all light
    that is at most. shares: see `light_shares` · bounce: (3,) albedo of the skin"""
    most = min(float(shares[-1] + np.max(bounce) * np.any(shares > 0)), 1.0)
    return float(fade(np.array(most), limits.world_shadow)), most


def lamp_rows(
    light: SceneLight, shares: np.ndarray, root_m: np.ndarray, points_m: np.ndarray, limits: Limits
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """The lamps that matter to a hand, as the kernel takes them (n, LAMP_NUMBERS), those whose shadows do, by slot, and
    which of the light's these are.

    shares:   see `light_shares`
    root_m:   (3,) of the hand; rows are relative to it
    points_m: (K, 3) of the hand, relative to the root
    """
    whole, middle_m = _rows(light, root_m), points_m.mean(0)
    weight, shade = lamp_weights(shares, limits), fade(shares[:-1], limits.lamp_shadow)
    rows: list[np.ndarray] = []
    sources: list[int] = []
    for index in np.argsort(-weight * shares[:-1], kind="stable"):
        lamp, row = light.lamps[index], whole[index]
        if weight[index] == 0:
            break
        row[NUMBER["red"] : NUMBER["blue"] + 1] *= weight[index]
        if lamp.has_shadow and shade[index] > 0:
            row[NUMBER["slot"]], row[NUMBER["shade"]] = len(sources), shade[index]
            sources.append(int(index))
        rows += _parts(lamp, row, middle_m)
    lamps = np.array(rows).reshape(-1, len(LAMP_NUMBERS))
    return _widened(lamps, middle_m), _widened(whole[sources], middle_m), sources


def irradiance_at(rows: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(n, K, 3) W/m2 that surfaces get which face the lamps of rows (n, LAMP_NUMBERS), at points (K, 3) of their
    frame."""
    kind = rows[:, NUMBER["kind"]]
    way_m = rows[:, None, :3] - points_m
    distance2 = np.maximum(np.square(way_m).sum(-1), DISTANCE2_MIN_M2)
    strength = 1 / (distance2 + rows[:, NUMBER["softening"], None])
    strength[kind == LampKind.SUN] = 1
    spots, areas = kind == LampKind.SPOT, kind == LampKind.AREA
    if spots.any() or areas.any():
        cosine = -(way_m * rows[:, None, 3:6]).sum(-1) / np.sqrt(distance2)
        strength[spots] *= _in_cone(rows[spots], cosine[spots])
        strength[areas] *= np.maximum(cosine[areas], 0) * _in_spread(rows[areas], cosine[areas])
    return strength[..., None] * rows[:, None, 6:9]


def _in_cone(rows: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    t = np.clip((cosine - rows[:, NUMBER["cone"], None]) * rows[:, NUMBER["cone_scale"], None], 0, 1)
    return t * t * (3 - 2 * t)


def _in_spread(rows: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    gain = rows[:, NUMBER["spread_gain"], None]
    tangent = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(cosine, COSINE_MIN)
    return np.where(gain > 0, np.maximum(rows[:, NUMBER["spread"], None] - tangent, 0) * gain, 1.0)


def _rows(light: SceneLight, root_m: np.ndarray) -> np.ndarray:
    """(lamps, LAMP_NUMBERS) of all lamps, relative to the root."""
    rows = np.array([lamp.numbers for lamp in light.lamps]).reshape(-1, len(LAMP_NUMBERS))
    rows[:, :3] -= np.where(rows[:, NUMBER["kind"], None] == LampKind.SUN, 0.0, root_m)
    return rows


def _widened(rows: np.ndarray, middle_m: np.ndarray) -> np.ndarray:
    """Narrow areas, of which each point shines into a cone, as points at their middles: their cones hold all of their
    light and are as wide as the areas where the hand is."""
    if not rows[:, NUMBER["spread_gain"]].any():
        return rows
    radius_m = np.sqrt(rows[:, NUMBER["radius2"]])
    distance_m = np.maximum(((middle_m - rows[:, :3]) * rows[:, 3:6]).sum(1), np.maximum(radius_m, 1e-6))
    cone = rows[:, NUMBER["spread"]] ** 3
    wider = np.where(rows[:, NUMBER["spread_gain"]] > 0, cone + (BEAM_RADII * radius_m / distance_m) ** 3, 0)
    rows = rows.copy()
    rows[:, NUMBER["spread"]] = np.cbrt(wider)
    rows[:, NUMBER["spread_gain"]] *= cone / np.maximum(wider, TINY)
    return rows


def _parts(lamp: Lamp, row: np.ndarray, middle_m: np.ndarray) -> list[np.ndarray]:
    """A large area as four small ones, which share a shadow; anything else alone."""
    distance2 = float(np.square(row[:3] - middle_m).sum())
    radius2 = row[NUMBER["radius2"]]
    if lamp.kind is not LampKind.AREA or radius2 < WHOLE_SINE_MAX**2 * (distance2 + radius2):
        return [row]
    side = np.array(lamp.side, np.float64)
    side = side - (side @ row[3:6]) * row[3:6]
    side /= max(float(np.linalg.norm(side)), 1e-12)
    across = np.cross(row[3:6], side)
    # four in one place, of the whole size, are the one: they part, and shrink, as the lamp grows
    grown = np.sqrt(radius2 / (distance2 + radius2)) / WHOLE_SINE_MAX - 1
    apart = min(float(grown) / (APART_SINE - 1), 1.0)
    # the middle of a quarter, as a part of the size
    quarter = apart * (2 / (3 * np.pi) if lamp.is_ellipse else 0.25)
    parts = []
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        part = row.copy()
        part[:3] += quarter * (a * lamp.size_m[0] * side + b * lamp.size_m[1] * across)
        for name in ("red", "green", "blue"):
            part[NUMBER[name]] /= 4
        for name in ("softening", "radius2"):
            part[NUMBER[name]] *= 1 - 0.75 * apart
        parts.append(part)
    return parts
