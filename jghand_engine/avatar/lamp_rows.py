"""Which lamps of a scene matter to a hand, and whose shadows do, as the kernel takes them (native/scene_light.cpp).

Nothing is switched: what goes below its limit has faded by then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.cast_task import posed_joints_m
from jghand_engine.avatar.scene_light import Lamp, SceneLight, World
from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.skeleton import Bones
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
# hands whose lamps are kept from the plan of an image to its drawing; more are compared twice
HANDS_KEPT = 4
# floors against division by zero
DISTANCE2_MIN_M2, COSINE_MIN, TINY = 1e-12, 1e-4, float(np.finfo(np.float64).tiny)


@dataclass(frozen=True)
class Limits:
    """Parts of all light at a hand below which something is left out; from twice of that on it is complete. 0 draws it
    always, infinity never.

    lamp:        light of a lamp
    lamp_shadow: light of a lamp whose shadow is
    sharp_shadow: light of a lamp whose shadow has the edges of surfaces
    world_shadow: what skin hides of the world and throws back itself
    """

    lamp: float = 0.002
    lamp_shadow: float = 0.005
    sharp_shadow: float = 0.02
    world_shadow: float = 0.02


LIMITS = Limits()


def fade(part: np.ndarray | float, limit: float) -> np.ndarray:
    """How much is drawn of what is such a part of the light, 0..1."""
    return np.minimum(np.maximum(part / max(limit, TINY) - 1, 0), 1)


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
    if not light.lamps:
        return np.array([float(world > 0)])
    rows = _widened(_rows(light, root_m), _middle(points_m))
    each = _strength_at(rows, points_m) * rows[:, 6:9].sum(1)[:, None]
    whole = np.maximum(each.sum(0) + world, TINY)
    return np.append((each / whole).max(1), world / whole.min())


# world and lamps of a light, bones of a hand, and what was found of these: of the last hands, newest first
_Found = tuple[World | None, tuple[Lamp, ...], Bones, tuple[np.ndarray, np.ndarray]]
_found: list[_Found] = []


def shares_on(light: SceneLight, bones: Bones, joints_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`light_shares` of a hand in a pose, and its points (61, 3), root-relative. The plan of an image and its drawing
    ask for the same: that of the last hands is kept. joints_m: (21, 3) of the canonical hand, root-relative"""
    for world, lamps, of, shares in tuple(_found):
        if world is light.world and lamps is light.lamps and of is bones:
            return shares
    points_m = compared_at(bones.linear_offset, joints_m)
    shares = light_shares(light, bones.root_m, points_m), points_m
    _found[:] = [(light.world, light.lamps, bones, shares), *_found[: HANDS_KEPT - 1]]
    return shares


def lamp_weights(shares: np.ndarray, limits: Limits) -> np.ndarray:
    """(lamps,) how much of each lamp is drawn, 0..1. shares: see `light_shares`"""
    weight = fade(shares[:-1], limits.lamp)
    if len(weight) > LAMPS_MAX:
        weight[np.argsort(-shares[:-1], kind="stable")[LAMPS_MAX:]] = 0
    return weight


def world_shade(shares: np.ndarray, bounce: np.ndarray, limits: Limits) -> tuple[float, float]:
    """How much is drawn of the shadow in the world and of what skin throws onto skin, 0..1, and which part of all light
    that is at most. shares: see `light_shares` · bounce: (3,) albedo of the skin"""
    most = min(float(shares[-1] + bounce.max() * (shares > 0).any()), 1.0)
    return float(fade(most, limits.world_shadow)), most


def lamp_rows(
    light: SceneLight, shares: np.ndarray, root_m: np.ndarray, points_m: np.ndarray, limits: Limits
) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """The lamps that matter to a hand, as the kernel takes them (n, LAMP_NUMBERS), those whose shadows do, by slot, and
    which of the light's these are.

    shares:   see `light_shares`
    root_m:   (3,) of the hand; rows are relative to it
    points_m: (K, 3) of the hand, relative to the root
    """
    if not light.lamps:
        nothing = np.zeros((0, len(LAMP_NUMBERS)))
        return nothing, nothing, []
    whole, middle_m = _rows(light, root_m), _middle(points_m)
    weights = lamp_weights(shares, limits)
    weight, shade = weights.tolist(), fade(shares[:-1], limits.lamp_shadow).tolist()
    rows: list[np.ndarray] = []
    sources: list[int] = []
    for index in np.argsort(-weights * shares[:-1], kind="stable").tolist():
        lamp, row = light.lamps[index], whole[index]
        if weight[index] == 0:
            break
        row[NUMBER["red"] : NUMBER["blue"] + 1] *= weight[index]
        if lamp.has_shadow and shade[index] > 0:
            row[NUMBER["slot"]], row[NUMBER["shade"]] = len(sources), shade[index]
            sources.append(index)
        rows += _parts(lamp, row, middle_m)
    lamps = np.array(rows).reshape(-1, len(LAMP_NUMBERS))
    return _widened(lamps, middle_m), _widened(whole[sources], middle_m), sources


def _middle(points_m: np.ndarray) -> np.ndarray:
    return points_m.sum(0) / len(points_m)


def irradiance_at(rows: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(n, K, 3) W/m2 that surfaces get which face the lamps of rows (n, LAMP_NUMBERS), at points (K, 3) of their
    frame."""
    return _strength_at(rows, points_m)[..., None] * rows[:, None, 6:9]


def _strength_at(rows: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(n, K) the same over the lamps' rgb."""
    kind = rows[:, NUMBER["kind"]]
    way_m = rows[:, None, :3] - points_m
    distance2 = np.maximum(np.einsum("nki,nki->nk", way_m, way_m), DISTANCE2_MIN_M2)
    strength = 1 / (distance2 + rows[:, NUMBER["softening"], None])
    strength[kind == LampKind.SUN] = 1
    spots, areas = kind == LampKind.SPOT, kind == LampKind.AREA
    for those, within in ((spots, _in_cone), (areas, _in_spread)):
        if those.any():
            way_to_them_m, lamps = way_m[those], rows[those]
            cosine = -np.einsum("nki,ni->nk", way_to_them_m, lamps[:, 3:6]) / np.sqrt(distance2[those])
            strength[those] *= within(lamps, cosine)
    return strength


def _in_cone(rows: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    t = (cosine - rows[:, NUMBER["cone"], None]) * rows[:, NUMBER["cone_scale"], None]
    t = np.minimum(np.maximum(t, 0), 1)
    return t * t * (3 - 2 * t)


def _in_spread(rows: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    front, gain = np.maximum(cosine, 0), rows[:, NUMBER["spread_gain"], None]
    if not gain.any():
        return front
    tangent = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(cosine, COSINE_MIN)
    return front * np.where(gain > 0, np.maximum(rows[:, NUMBER["spread"], None] - tangent, 0) * gain, 1.0)


def _rows(light: SceneLight, root_m: np.ndarray) -> np.ndarray:
    """(lamps, LAMP_NUMBERS) of all lamps, relative to the root."""
    rows = light.lamp_numbers.copy()
    rows[:, :3] -= (rows[:, NUMBER["kind"], None] != LampKind.SUN) * root_m
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
    if lamp.kind is not LampKind.AREA:
        return [row]
    distance2, radius2 = math.dist(row[:3], middle_m) ** 2, float(row[NUMBER["radius2"]])
    if radius2 < WHOLE_SINE_MAX**2 * (distance2 + radius2):
        return [row]
    # four in one place, of the whole size, are the one: they part, and shrink, as the lamp grows
    grown = math.sqrt(radius2 / (distance2 + radius2)) / WHOLE_SINE_MAX - 1
    apart = min(grown / (APART_SINE - 1), 1.0)
    # the middle of a quarter, as a part of the size
    quarter = apart * (2 / (3 * math.pi) if lamp.is_ellipse else 0.25)
    half = quarter * lamp.sides * np.array(lamp.size_m)[:, None]
    parts = np.repeat(row[None], 4, 0)
    parts[:, :3] += [-half[0] - half[1], half[1] - half[0], half[0] - half[1], half[0] + half[1]]
    parts[:, NUMBER["red"] : NUMBER["blue"] + 1] /= 4
    parts[:, [NUMBER["softening"], NUMBER["radius2"]]] *= 1 - 0.75 * apart
    return [*parts]
