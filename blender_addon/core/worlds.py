# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a world: averaged from an environment's, or made from what a light probe measured; and the triangles on
which Cycles bakes light. No bpy.

They are equirectangular as Blender has them: +z above the first row, +x in the middle, +y a quarter to the left of it.
A probe is a mirror ball and a white one in one: mirrors say from where light comes, white facets how much of it there
is, which mirrors alone miss where a sun is smaller than what lies between them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .pacing import digest
from .view import LIGHT_FROM_WORLD

# pictures have at most so many rows and twice as many columns; those of probes, and of one color, have fewer
ROWS_MAX, PROBE_ROWS = 256, 32
# of every so many corners of a probe's pixels one is white
WHITE_STEP = 3
# parts of the sphere whose light is measured by white facets, each on its own, and rounds of that
CELLS, ROUNDS = 64, 1000
# what mirrors see of black things may hold a sun that they missed: this part of the mean
LEAST_SEEN = 0.02
# facets have this part of the room between them
FILLED = 0.15
# directions in a sun's disc that are looked at, from so many radii beside the ball; its edge is as sharp as float32
SUN_RINGS, SUN_TURNS, SUN_AWAY, SUN_EDGE_RAD = 4, 16, 4.0, 1e-4
_JOINTS_FROM_BLENDER = LIGHT_FROM_WORLD[:3, :3]


@dataclass(frozen=True)
class WorldLight:
    """What lights from far away.

    radiance:         (H, W, 3) float32, 0 and up, W/(m2 sr), Rec.709
    env_from_blender: (3, 3) rotation from Blender's axes to the picture's
    suns:             lamps that are no part of the picture, as the engine takes them
    key:              changes whenever the picture does
    """

    radiance: np.ndarray
    env_from_blender: np.ndarray = field(default_factory=lambda: np.eye(3))
    suns: tuple[Mapping[str, Any], ...] = ()
    key: str = ""

    @property
    def record(self) -> dict[str, Any]:
        turn = self.env_from_blender @ _JOINTS_FROM_BLENDER.T
        return {"key": self.key, "env_from_world": turn.tolist()}


def in_joints(turn: np.ndarray) -> np.ndarray:
    """A rotation (3, 3) in Blender's axes, as one in those of the joints."""
    return _JOINTS_FROM_BLENDER @ turn @ _JOINTS_FROM_BLENDER.T


def even(rgb: np.ndarray) -> WorldLight:
    radiance = np.broadcast_to(rgb.astype(np.float32), (PROBE_ROWS, 2 * PROBE_ROWS, 3))
    return WorldLight(np.ascontiguousarray(radiance), key=digest(["even", repr(rgb.tolist())]))


def averaged(picture: np.ndarray) -> np.ndarray:
    """A picture (H, W, C) of at most 256 x 512: each pixel the mean of its part of the sphere."""
    rows, columns = picture.shape[:2]
    # the height of a band of the sphere is its solid angle
    heights = [_heights(count) for count in (rows, min(rows, ROWS_MAX))]
    around = [np.linspace(0, 1, count + 1) for count in (columns, min(columns, 2 * ROWS_MAX))]
    return _means(_means(picture, *heights).swapaxes(0, 1), *around).swapaxes(0, 1)


def _means(values: np.ndarray, edges: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Values (N, ...) of the spans between `edges` (N + 1,), averaged over those between `wanted`."""
    out = np.empty((len(wanted) - 1, *values.shape[1:]), np.float32)
    first = np.searchsorted(edges, wanted[:-1], "right") - 1
    last = np.searchsorted(edges, wanted[1:], "left")
    for span, (begin, end) in enumerate(zip(first, last, strict=True)):
        inside = np.clip(edges[begin : end + 1], wanted[span], wanted[span + 1])
        share = np.diff(inside) / (wanted[span + 1] - wanted[span])
        out[span] = np.tensordot(share.astype(np.float32), values[begin:end], 1)
    return out


def _heights(rows: int) -> np.ndarray:
    """(rows + 1,) minus the sine of the latitudes between rows, from the top."""
    return -np.sin(np.linspace(np.pi / 2, -np.pi / 2, rows + 1))


def directions(up: np.ndarray, around: np.ndarray) -> np.ndarray:
    """(U, A, 3) of latitudes (U,), from the top, and of azimuths (A,) from +x to +y, radians."""
    parts = np.cos(up)[:, None] * np.cos(around), np.cos(up)[:, None] * np.sin(around), np.sin(up)[:, None]
    return np.stack(np.broadcast_arrays(*parts), -1)


def _pixels(rows: int, offset: float, step: int = 1) -> np.ndarray:
    """(N, 3) directions of pixels, `offset` of a pixel from their upper left corners."""
    down = np.arange(0 if offset else step, rows, step) + offset
    across = np.arange(0, 2 * rows, step) + offset
    return directions(np.pi * (0.5 - down / rows), np.pi * (1 - across / rows)).reshape(-1, 3)


# ---- light probes ----------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sun:
    """The disc of a sky. towards: (3,) unit, in the axes of the probe; angle_rad: across."""

    towards: np.ndarray
    angle_rad: float


@dataclass(frozen=True)
class Probe:
    """A ball of flat facets that look away from its middle, and beside it those that look at a sun's disc.

    place:   (F, 3) in radii of the ball
    normal:  (F, 3) unit, in Blender's axes: first of mirrors, as many as a picture has pixels, then of white facets,
             at last of mirrors for the sun
    size:    (F,) in radii: no facet is in the way of another
    whites:  how many are white
    """

    place: np.ndarray
    normal: np.ndarray
    size: np.ndarray
    whites: int
    sun: Sun | None = None

    @property
    def is_white(self) -> np.ndarray:
        """(F,) bool."""
        place = np.arange(len(self.normal)) - 2 * PROBE_ROWS**2
        return (place >= 0) & (place < self.whites)


def probe(sun: Sun | None = None) -> Probe:
    """A probe that, if there is a sun, looks at its disc too."""
    white = _pixels(PROBE_ROWS, 0.0, WHITE_STEP)
    normal = np.concatenate([_pixels(PROBE_ROWS, 0.5), white])
    # pixels are narrower towards the poles
    size = FILLED * np.pi / PROBE_ROWS * np.linalg.norm(normal[:, :2], axis=1)
    if sun is None:
        return Probe(normal, normal, size, len(white))
    side = np.cross(sun.towards, np.eye(3)[np.abs(sun.towards).argmin()])
    side /= np.linalg.norm(side)
    sides = np.stack([side, np.cross(sun.towards, side)])
    ring, turn = np.divmod(np.arange(SUN_RINGS * SUN_TURNS), SUN_TURNS)
    away = np.sqrt((ring + 0.5) / SUN_RINGS)[:, None] * sun.angle_rad / 2  # rings of equal area
    turn = 2 * np.pi * (turn + ring / SUN_RINGS)[:, None] / SUN_TURNS
    disc = np.cos(away) * sun.towards + np.sin(away) * np.concatenate([np.cos(turn), np.sin(turn)], 1) @ sides
    # on a plane across the sun's direction, far enough from the ball to hide little of it
    plane = SUN_AWAY * side + FILLED * np.stack([ring, turn[:, 0]], 1) @ sides
    return Probe(
        np.concatenate([normal, plane]),
        np.concatenate([normal, disc]),
        np.append(size, np.full(len(disc), FILLED / 10)),
        len(white),
        sun,
    )


def measured(probe: Probe, out: np.ndarray) -> WorldLight:
    """The light of which so much, (F, 3) radiance, leaves the facets of a probe."""
    count = 2 * PROBE_ROWS**2
    seen, white, disc = np.split(out.astype(np.float64), [count, count + probe.whites])
    towards, normal = np.split(probe.normal[: count + probe.whites], [count])
    irradiance, suns = np.pi * white, ()
    if probe.sun is not None:
        sun = probe.sun
        power = disc.mean(0) * 2 * np.pi * (1 - np.cos(sun.angle_rad / 2))
        irradiance = irradiance - np.maximum(normal @ sun.towards, 0)[:, None] * power
        # a pixel in whose middle the disc is has its neighbor's sky
        inside = towards @ sun.towards > np.cos(sun.angle_rad / 2 + SUN_EDGE_RAD)
        seen[inside] = seen[~inside][(towards[inside] @ towards[~inside].T).argmax(1)]
        place = _JOINTS_FROM_BLENDER @ sun.towards
        suns = ({"kind": "sun", "rgb": power.tolist(), "place_m": place.tolist(), "angle_rad": sun.angle_rad},)
    radiance = _with_light(towards, seen, normal, np.maximum(irradiance, 0)).astype(np.float32)
    picture = radiance.reshape(PROBE_ROWS, 2 * PROBE_ROWS, 3)
    return WorldLight(picture, suns=suns, key=digest(["probe", picture.tobytes()]))


def _with_light(towards: np.ndarray, seen: np.ndarray, normal: np.ndarray, irradiance: np.ndarray) -> np.ndarray:
    """(P, 3) radiance of pixels as they were seen, each of 64 parts of the sphere as much brighter as white facets say.

    Non-negative least squares by multiplicative updates, which leave alone what no facet contradicts: Lee and Seung,
    2001.
    """
    seen = seen + LEAST_SEEN * irradiance.mean(0) / np.pi
    solid_angle = np.repeat(np.diff(_heights(PROBE_ROWS)) * np.pi / PROBE_ROWS, 2 * PROBE_ROWS)
    cell = (towards @ _evenly(CELLS).T).argmax(1)
    cosine = np.maximum(normal @ towards.T, 0) * solid_angle
    out = np.empty_like(seen)
    for channel in range(3):
        of_cells = np.zeros((CELLS, len(normal)))
        np.add.at(of_cells, cell, (cosine * seen[:, channel]).T)
        square, wanted = of_cells @ of_cells.T, of_cells @ irradiance[:, channel]
        gain = np.ones(CELLS)
        for _ in range(ROUNDS):
            gain *= wanted / np.maximum(square @ gain, 1e-30)
        out[:, channel] = seen[:, channel] * gain[cell]
    return out


def _evenly(count: int) -> np.ndarray:
    """(count, 3) unit vectors all around: a spiral of golden angles."""
    place = np.arange(count) + 0.5
    height, turn = 1 - 2 * place / count, np.pi * (1 + 5**0.5) * place
    ring = np.sqrt(1 - height**2)
    return np.stack([ring * np.cos(turn), ring * np.sin(turn), height], -1)


# ---- facets: those of a probe, and those above points of the skin, which say how much light falls there and how that
# turns with the normal ------------------------------------------------------------------------------------------------
# Skin's own normals turn between two points, and a mean over neighbors must not round off what they see: so a point has
# facets that look along its normal, and others that are tilted away from it, and what is kept is the field of light
# E(n) = a + n @ b that fits them.

# a facet lies so far above the skin, meters: faces of the hand's surface are flat, and rays must not begin below the
# next one; and reaches so far from its middle: a tilted one stays above the skin
LIFT_M, RADIUS_M = 1e-3, 4e-4
# by how much facets are tilted: as much as skin turns within a centimeter
TILT_RAD = 0.7
# two look along the normal: what they see counts for more than how it turns
_UP, _TILTED = 2, 3
LOOKS = _UP + _TILTED


def triangles(place: np.ndarray, normal: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
    """(N, 3, 3) corners of even triangles around places (N, 3) that face unit normals (N, 3)."""
    side, across = _sides(normal)
    turn = 2 * np.pi * np.arange(3)[:, None, None] / 3
    corners = np.cos(turn) * side + np.sin(turn) * across
    return (place + np.reshape(radius, (-1, 1)) * corners).swapaxes(0, 1)


def above_skin(points_m: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N LOOKS, 3, 3) corners, meters, of the facets above points of the skin (N, 3) with unit normals (N, 3)."""
    looks = np.einsum("kl,lna->nka", _looks(), np.stack([*_sides(normals), normals]))
    places = (points_m + LIFT_M * normals)[:, None] + np.zeros_like(looks)
    return triangles(places.reshape(-1, 3), looks.reshape(-1, 3), RADIUS_M)


def fields(radiance: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N, 4, 3) a, and the rows of b, W/m2, of the light at points with normals (N, 3), from the radiance (N LOOKS, 3)
    that their white facets throw back."""
    fit = np.linalg.pinv(np.concatenate([np.ones((LOOKS, 1)), _looks()], 1))
    local = np.einsum("fk,nkc->nfc", fit, np.pi * radiance.reshape(-1, LOOKS, 3))
    axes = np.stack([*_sides(normals), normals], 1)
    return np.concatenate([local[:, :1], np.einsum("nla,nlc->nac", axes, local[:, 1:])], 1)


def _looks() -> np.ndarray:
    """(LOOKS, 3) where the facets of a point look, along its sides and its normal."""
    turn = 2 * np.pi * np.arange(_TILTED) / _TILTED
    tilted = np.stack([np.cos(turn), np.sin(turn)], 1) * np.sin(TILT_RAD)
    return np.concatenate(
        [np.tile([0, 0, 1], (_UP, 1)), np.pad(tilted, ((0, 0), (0, 1)), constant_values=np.cos(TILT_RAD))]
    )


def _sides(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (N, 3) unit vectors at right angles to normals and to each other."""
    side = np.cross(normal, np.where(np.abs(normal[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(normal, side)
