"""The light of a scene, as the kernel takes it (native/scene_light.cpp). The specification is learn/scene_light.py."""

from __future__ import annotations

import ctypes
from functools import lru_cache

import numpy as np

from jghand_engine.avatar.blocks import Blocks, set_pointers
from jghand_engine.avatar.cast_task import CAPSULE_SINE2_MIN, CastStep
from jghand_engine.avatar.learned import SkinResponse
from jghand_engine.avatar.scene_light import (
    CELLS,
    LOBES,
    WORLD_FLOOR,
    Lamp,
    SceneLight,
    World,
    mirrored_lobes,
)
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.binding import aligned_zeros
from jghand_engine.native.learned_tasks import LearnedTask
from jghand_engine.native.scene_light_task import LAMP_NUMBERS, LampKind, SceneLightTask
from jghand_engine.native.tasks import LANES

# edge of a lamp's shadow on skin, as a part of the capsule's radius
FLESH_SOFTNESS = 0.12
# lamps in a scene, of which each casts its own shadow
LAMPS_MAX = 32
# an area that is larger, by the sine of its half angle, is four lamps
WHOLE_SINE_MAX = 0.12
# parts of all light at the hand below which a lamp is left out, and casts no shadow
LAMP_PART_MIN, SHADOW_PART_MIN = 0.002, 0.005
# radii of a narrow area, or of a part of it, that its beam is wider by: where beams of four parts meet is light, too
BEAM_RADII = 1.7
# half of a hand's length, meters: some of it may be in a beam that passes its middle by
HALF_HAND_M = 0.1
# fade of a spot without one: a step of its cosine
BLEND_MIN = 1e-3
# concentration of a spherical Gaussian that is as wide as GGX mirrors, over 1 / roughness^4: half the angle in the
# half vector is a quarter of it in the mirrored direction
MIRROR_SHARPNESS = 0.5
# W/m2 that no shadow takes, at least: a black channel is not divided by
AMBIENT_MIN = 1e-12
# in level order
MIDDLE_KNUCKLE = 3
# without a world its cells are black
BLACK = World(np.zeros((2, 4, 3)))
NUMBER = {name: place for place, name in enumerate(LAMP_NUMBERS)}


class SceneLightStep:
    """Fills in a task what the light of a scene does to its poses. It must live as long as the task.

    response: of the skin, in the avatar's own order · blocks: of its Gaussians · cast: whose anchors it uses
    """

    def __init__(self, response: SkinResponse, blocks: Blocks, cast: CastStep, task: LearnedTask) -> None:
        self._response, self._cast = response, cast
        material = np.stack([response.spread, response.roughness, response.reflectance], 1)
        rows = cast.rows
        self._arrays = {
            "material": blocks.blocked(material),
            "posed": aligned_zeros((rows // LANES, 9, LANES)),
            "visible": aligned_zeros((rows, CELLS)),
            "reflecting": aligned_zeros((blocks.rows // LANES, 3, LANES)),
            "seen": aligned_zeros((LAMPS_MAX, rows)),
            "skin_seen": aligned_zeros((LAMPS_MAX, blocks.rows)),
            "thrown": aligned_zeros((CELLS // LANES, 3, LANES)),
            "reached": aligned_zeros((rows, 8)),
            "irradiance": aligned_zeros((16, 3)),
            "left": aligned_zeros((LAMPS_MAX, rows)),
            "lobe": aligned_zeros((LOBES, 7)),
            "lamp": aligned_zeros((4 * LAMPS_MAX, len(LAMP_NUMBERS))),
            "casting": aligned_zeros((LAMPS_MAX, len(LAMP_NUMBERS))),
        }
        self._task = SceneLightTask(
            shade_gain=response.shade_gain, flesh_softness=FLESH_SOFTNESS, sine2_min=CAPSULE_SINE2_MIN
        )
        set_pointers(self._task, self._arrays)
        task.scene = ctypes.addressof(self._task)
        self._world: World | None = None
        self._set_world(None)

    def prepare(self, light: SceneLight, bones: Bones, *, keep_pose: bool = False) -> None:
        """Sets the light of the next pose, or of the one that stands; the hand's capsules are the cast shadow's, whose
        `prepare` comes after this: shadows of the world are found for its own directions."""
        self._task.keeps_pose = keep_pose
        self._task.keeps_visible = keep_pose and light.world is self._world
        if light.world is not self._world:
            self._set_world(light.world)
        middle_m = palm_middle_m(bones.linear_offset, self._cast.joints_m)
        rows, casting, sources = lamp_rows(light, bones.root_m, middle_m)
        self._arrays["lamp"][: len(rows)], self._arrays["casting"][: len(casting)] = rows, casting
        self._task.lamps, self._task.slots = len(rows), len(casting)
        self._set_left(None if light.shades is None else light.shades.left[0], sources)

    def _set_left(self, of_lamp: np.ndarray | None, sources: list[int]) -> None:
        """Sets what a scene leaves of the lamps (lamps, anchors), as `Shades` has it; sources: the lamps by slot."""
        left = self._arrays["left"]
        self._task.left = None if of_lamp is None else left.ctypes.data
        if of_lamp is not None:
            left[...] = 1
            for slot, index in enumerate(sources):
                if index < len(of_lamp):
                    left[slot, self._cast.row_of_anchor] = of_lamp[index]

    def _set_world(self, world: World | None) -> None:
        task, response = self._task, self._response
        self._world = world
        terms = (BLACK if world is None else world).terms
        mean = terms.mean_irradiance
        self._arrays["irradiance"][...] = terms.irradiance(response.softness)
        self._cast.set_lamps(terms.direction, terms.light)
        task.lobes = 0 if world is None else LOBES
        if world is not None:
            self._arrays["lobe"][...] = mirrored(world, response.roughness)
            self._arrays["lobe"][:, 3] /= np.log(2)
        task.ambient = tuple(np.maximum(response.ambient * mean, AMBIENT_MIN).tolist())
        task.least = tuple((WORLD_FLOOR * mean).tolist())
        task.bounce = tuple((response.bounce / np.pi * (4 * np.pi / CELLS)).tolist())
        task.softness = tuple(response.softness.tolist())


def mirrored(world: World, roughness: np.ndarray) -> np.ndarray:
    """(LOBES, 7) what skin of a mean roughness mirrors of the world, see `mirrored_lobes`."""
    return _lobes(world, MIRROR_SHARPNESS / float(np.mean(roughness)) ** 4)


@lru_cache(maxsize=4)
def _lobes(world: World, sharpness: float) -> np.ndarray:
    return mirrored_lobes(world, sharpness)


def palm_middle_m(linear_offset: np.ndarray, joints_m: np.ndarray) -> np.ndarray:
    """(3,) half way from the wrist to the middle knuckle, root-relative. linear_offset: (21, 3, 4) of the bones ·
    joints_m: (21, 3) of the canonical hand, root-relative"""
    matrix = np.asarray(linear_offset[0], np.float64)
    return matrix[:, :3] @ (0.5 * joints_m[MIDDLE_KNUCKLE]) + matrix[:, 3]


def lamp_rows(light: SceneLight, root_m: np.ndarray, middle_m: np.ndarray) -> tuple[np.ndarray, np.ndarray, list[int]]:
    """The lamps that matter to a hand, as the kernel takes them (n, LAMP_NUMBERS), those whose shadows do, by slot, and
    which of the light's these are.

    root_m:   (3,) of the hand; rows are relative to it
    middle_m: (3,) of the hand, relative to the root: where lamps are compared
    """
    plain = [_row(lamp, root_m) for lamp in light.lamps]
    whole = [_widened(row, middle_m) for row in plain]
    looks = middle_m + HALF_HAND_M * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    power = np.array([irradiance_at(row, looks).sum(-1).max() for row in whole])
    world = 0.0 if light.world is None else float(light.world.terms.mean_irradiance.sum())
    every = float(power.sum()) + world
    rows: list[np.ndarray] = []
    casting: list[np.ndarray] = []
    sources: list[int] = []
    for index in np.argsort(-power, kind="stable")[:LAMPS_MAX]:
        lamp = light.lamps[index]
        if power[index] <= LAMP_PART_MIN * every:
            break
        if lamp.has_shadow and power[index] > SHADOW_PART_MIN * every:
            plain[index][NUMBER["slot"]] = whole[index][NUMBER["slot"]] = len(casting)
            casting.append(whole[index])
            sources.append(int(index))
        rows += [_widened(part, middle_m) for part in _parts(lamp, plain[index], middle_m)]
    lamps, shadows = (np.array(each).reshape(-1, len(LAMP_NUMBERS)) for each in (rows, casting))
    return lamps, shadows, sources


def irradiance_at(row: np.ndarray, points_m: np.ndarray) -> np.ndarray:
    """(..., 3) W/m2 that surfaces get which face the lamp of a row, at points (..., 3) in the row's frame."""
    rgb, kind = row[NUMBER["red"] : NUMBER["blue"] + 1], int(row[NUMBER["kind"]])
    if kind == LampKind.SUN:
        return np.broadcast_to(rgb, points_m.shape)
    way_m = row[:3] - points_m
    distance2 = np.maximum(np.square(way_m).sum(-1), 1e-12)
    strength = 1 / (distance2 + row[NUMBER["softening"]])
    cosine = -(way_m @ row[3:6]) / np.sqrt(distance2)
    if kind == LampKind.SPOT:
        t = np.clip((cosine - row[NUMBER["cone"]]) * row[NUMBER["cone_scale"]], 0, 1)
        strength = strength * t * t * (3 - 2 * t)
    if kind == LampKind.AREA:
        strength = strength * np.maximum(cosine, 0)
        if row[NUMBER["spread_gain"]] > 0:
            tangent = np.sqrt(np.maximum(1 - cosine * cosine, 0)) / np.maximum(cosine, 1e-4)
            strength = strength * np.maximum(row[NUMBER["spread"]] - tangent, 0) * row[NUMBER["spread_gain"]]
    return rgb * strength[..., None]


def _widened(row: np.ndarray, middle_m: np.ndarray) -> np.ndarray:
    """A narrow area, of which each point shines into a cone, as one point at its middle: its cone holds all of their
    light and is as wide as the area where the hand is."""
    if row[NUMBER["spread_gain"]] == 0:
        return row
    row = row.copy()
    radius_m = np.sqrt(row[NUMBER["radius2"]])
    distance_m = max(float((middle_m - row[:3]) @ row[3:6]), radius_m, 1e-6)
    cone = row[NUMBER["spread"]] ** 3
    wider = cone + (BEAM_RADII * radius_m / distance_m) ** 3
    row[NUMBER["spread"]] = wider ** (1 / 3)
    row[NUMBER["spread_gain"]] *= cone / wider
    return row


def _row(lamp: Lamp, root_m: np.ndarray) -> np.ndarray:
    row = np.zeros(len(LAMP_NUMBERS))
    place, axis, rgb = (np.array(value, np.float64) for value in (lamp.place_m, lamp.axis, lamp.rgb))
    sun = lamp.kind is LampKind.SUN
    row[:3] = place / np.linalg.norm(place) if sun else place - root_m
    row[3:6] = axis / max(float(np.linalg.norm(axis)), 1e-12)
    values = {"kind": lamp.kind, "slot": -1, "on_matt": lamp.on_matt, "on_gloss": lamp.on_gloss}
    if sun:
        values["sun_sine"] = np.sin(min(lamp.angle_rad, np.pi) / 2)
    elif lamp.kind is LampKind.AREA:
        area_m2 = lamp.size_m[0] * lamp.size_m[1] * (np.pi / 4 if lamp.is_ellipse else 1.0)
        # far away radiance times area is what a point sends; near, a disk of the same area
        rgb, values["softening"] = rgb * area_m2, area_m2 / np.pi
        values["radius2"] = area_m2 / np.pi
        half = min(lamp.spread_rad / 2, np.pi / 2)
        if half < np.pi / 2 - 1e-3:
            # all light in an ever narrower beam: a thousandth is none
            half = max(half, 1e-3)
            values["spread"], values["spread_gain"] = np.tan(half), 1 / (np.tan(half) - half)
    else:
        values["radius2"] = lamp.radius_m**2
        values["softening"] = lamp.radius_m**2 if lamp.is_soft else 0.0
    if lamp.kind is LampKind.SPOT:
        cone = np.cos(min(lamp.cone_rad, 2 * np.pi) / 2)
        values["cone"], values["cone_scale"] = cone, 1 / max((1 - cone) * lamp.blend, BLEND_MIN * BLEND_MIN)
    row[6:9] = rgb
    for name, value in values.items():
        row[NUMBER[name]] = value
    return row


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
    # the middle of a quarter, as a part of the size
    quarter = 2 / (3 * np.pi) if lamp.is_ellipse else 0.25
    parts = []
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        part = row.copy()
        part[:3] += quarter * (a * lamp.size_m[0] * side + b * lamp.size_m[1] * across)
        for name in ("red", "green", "blue", "softening", "radius2"):
            part[NUMBER[name]] /= 4
        parts.append(part)
    return parts
