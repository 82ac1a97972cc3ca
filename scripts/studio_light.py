"""Soft studio light, baked: how much light each point of the canonical skin receives, and the color that it then has.

Gaussians have one color and no light at run time, so a flat albedo would look like cardboard. The irradiance of a
soft studio (a dome and a few large lights on both sides of the hand) is integrated over directions with the
visibility of each direction, found by sphere tracing in a signed distance grid of the template.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from painted_skin import MM, Landmarks, MarkPainter, SkinLook, SkinMarks, reflectance
from scipy.ndimage import binary_fill_holes, distance_transform_edt

from jghand_engine.captures.making.skin import SkinPoints
from jghand_engine.captures.skin.noise import smoothstep
from jghand_engine.color import linear_to_srgb
from jghand_engine.hand.rotations import unit
from jghand_engine.template.mesh import HandTemplate

GRID_STEP_M = 0.0007
GRID_MARGIN_M = 0.004
# rays start this far above the skin and end after this length: what is further away hides little
RAY_START_M = 0.0016
RAY_LENGTH_M = 0.12
RAY_STEPS = 28


@dataclass(frozen=True)
class SoftLight:
    """A large lamp: radiance * exp(sharpness * (w . direction - 1)), linear RGB; direction need not be of length 1."""

    direction: tuple[float, float, float]
    rgb: tuple[float, float, float]
    sharpness: float


@dataclass(frozen=True)
class Studio:
    """The lights, in the canonical frame: warm keys from above for palm and back, fills, a rim on each side.

    wrap: how far each color channel reaches past the terminator, for light that wanders under the skin (red most).
    translucency: what reaches even the bottom of a fold, through the skin.
    """

    ambient: tuple[float, float, float] = (0.225, 0.22, 0.225)
    wrap: tuple[float, float, float] = (0.26, 0.15, 0.11)
    translucency: tuple[float, float, float] = (0.24, 0.15, 0.13)
    lights: tuple[SoftLight, ...] = field(
        default=(
            SoftLight((0.50, 0.50, 0.90), (4.6, 4.4, 4.15), 10.0),
            SoftLight((-0.65, -0.15, 0.75), (0.68, 0.68, 0.72), 5.0),
            SoftLight((0.50, 0.50, -0.90), (4.6, 4.4, 4.15), 10.0),
            SoftLight((-0.65, -0.15, -0.75), (0.68, 0.68, 0.72), 5.0),
        )
    )

    def radiance(self, direction: np.ndarray) -> np.ndarray:
        """(D, 3) unit directions towards the light -> (D, 3) linear RGB."""
        total = np.tile(np.array(self.ambient), (len(direction), 1))
        for light in self.lights:
            cosine = direction @ unit(np.array(light.direction))
            total += np.exp(light.sharpness * (cosine - 1))[:, None] * np.array(light.rgb)
        return total


class Occluder:
    """A signed distance grid of a closed surface, for visibility."""

    def __init__(self, vertices_m: np.ndarray, faces: np.ndarray) -> None:
        self._low_m = vertices_m.min(0) - GRID_MARGIN_M
        shape = np.ceil((vertices_m.max(0) + GRID_MARGIN_M - self._low_m) / GRID_STEP_M).astype(int) + 1
        inside = np.zeros(shape, bool)
        cells = np.rint((_surface_points(vertices_m, faces, GRID_STEP_M / 2) - self._low_m) / GRID_STEP_M).astype(int)
        inside[tuple(cells.T)] = True
        filled = np.asarray(binary_fill_holes(inside), dtype=bool)
        outer, inner = np.asarray(distance_transform_edt(~filled)), np.asarray(distance_transform_edt(filled))
        self._distance_m = ((outer - inner) * GRID_STEP_M).astype(np.float32)

    def distance_m(self, points_m: np.ndarray) -> np.ndarray:
        """(N,) signed distance, nearest cell; outside the grid the distance to the grid plus its margin."""
        cell = np.rint((points_m - self._low_m) / GRID_STEP_M).astype(np.int32)
        near = np.clip(cell, 0, np.array(self._distance_m.shape, np.int32) - 1)
        beyond_m = np.abs(cell - near).max(1) * GRID_STEP_M
        return self._distance_m[near[:, 0], near[:, 1], near[:, 2]] + beyond_m.astype(np.float32)

    def lifted(self, points_m: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """(N, 3) points moved outwards along `normal` until they are RAY_START_M clear of the surface."""
        lifted = (points_m + RAY_START_M * normal).astype(np.float32)
        for _ in range(4):
            missing = np.clip(RAY_START_M - self.distance_m(lifted), 0, None)
            lifted = lifted + missing[:, None] * normal.astype(np.float32)
        return lifted

    def visible(self, points_m: np.ndarray, direction: np.ndarray) -> np.ndarray:
        """(N,) bool: the ray from each point along `direction` (3,) leaves the hand."""
        traveled = np.zeros(len(points_m), np.float32)
        alive = np.arange(len(points_m))
        seen = np.ones(len(points_m), bool)
        for _ in range(RAY_STEPS):
            d = self.distance_m(points_m[alive] + traveled[alive, None] * direction)
            hit = d < 0.25 * GRID_STEP_M
            seen[alive[hit]] = False
            traveled[alive] += np.maximum(d, 0.5 * GRID_STEP_M)
            alive = alive[~hit & (traveled[alive] < RAY_LENGTH_M)]
            if not len(alive):
                break
        return seen


@dataclass(frozen=True)
class BakedLight:
    """irradiance: (N, 3) linear RGB, 1 = a white surface stays white; openness: (N,) unoccluded share of the dome."""

    irradiance: np.ndarray
    openness: np.ndarray


def bake_light(
    position_m: np.ndarray, normal: np.ndarray, bumped: np.ndarray, occluder: Occluder, studio: Studio, rays: int = 192
) -> BakedLight:
    """Integrates the studio over `rays` directions.

    position_m, normal (N, 3): the smooth skin, from which rays start; bumped (N, 3): its normals with relief.
    """
    directions = sphere_directions(rays)
    radiance = studio.radiance(directions)
    wrap = np.array(studio.wrap)
    start_m = occluder.lifted(position_m, normal)
    light = np.zeros((len(position_m), 3))
    open_, dome = np.zeros(len(position_m)), np.zeros(len(position_m))
    for direction, color in zip(directions, radiance, strict=True):
        cosine = bumped @ direction
        facing = np.flatnonzero(cosine > -wrap.max())
        seen = occluder.visible(start_m[facing], direction.astype(np.float32))
        wrapped = np.maximum(0, (cosine[facing, None] + wrap) / (1 + wrap)) / (1 + wrap)
        light[facing] += wrapped * seen[:, None] * color
        upright = np.maximum(0, cosine[facing])
        open_[facing] += upright * seen
        dome[facing] += upright
    irradiance = np.maximum(light * (4 / rays), studio.translucency)
    return BakedLight(irradiance, open_ / np.maximum(dome, 1e-9))


def sphere_directions(count: int) -> np.ndarray:
    """(count, 3) unit directions spread evenly over the sphere (Fibonacci lattice)."""
    k = np.arange(count) + 0.5
    z = 1 - 2 * k / count
    angle = np.pi * (1 + 5**0.5) * k
    ring = np.sqrt(1 - z * z)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle), z], 1)


def _surface_points(vertices_m: np.ndarray, faces: np.ndarray, step_m: float) -> np.ndarray:
    """Points on all faces, at most `step_m` apart."""
    a, b, c = (vertices_m[faces[:, k]] for k in range(3))
    longest = np.max([np.linalg.norm(e, axis=1) for e in (b - a, c - b, a - c)])
    n = int(np.ceil(longest / step_m))
    i, j = np.array([(i, j) for i in range(n + 1) for j in range(n + 1 - i)]).T / n
    return (a[:, None] * (1 - i - j)[:, None] + b[:, None] * i[:, None] + c[:, None] * j[:, None]).reshape(-1, 3)


def skin_rgb(template: HandTemplate, points: SkinPoints, look: SkinLook, studio: Studio) -> np.ndarray:
    """Display-referred sRGB (N, 3), 0..1, of the skin at `points` of the canonical hand."""
    landmarks = Landmarks.of(template.joints_m)
    painter = MarkPainter(points, landmarks)
    marks = painter.paint(points.position_m)
    bumped = relief_normals(points, painter, look.relief)
    occluder = Occluder(template.vertices_m, template.faces)
    light = bake_light(points.position_m, points.normal, bumped, occluder, studio)
    albedo = reflectance(points, marks, landmarks, look)
    lit = albedo * light.irradiance * depth_tint(light, albedo)
    shine = gloss(points.normal, bumped, marks, light, studio) * look.gloss
    return display(look.exposure * (lit + shine))


def relief_normals(points: SkinPoints, painter: MarkPainter, strength: float) -> np.ndarray:
    """(N, 3) normals of the skin with its relief: the smooth normal minus the slope of the height."""
    step_m = 0.15 * MM
    normal = points.normal
    helper = np.where(np.abs(normal[:, 2:]) < 0.8, [[0.0, 0.0, 1.0]], [[0.0, 1.0, 0.0]])
    tangent = unit(np.cross(normal, helper))
    slope = np.zeros_like(normal)
    for direction in (tangent, np.cross(normal, tangent)):
        ahead = painter.paint(points.position_m + step_m * direction).height_m
        behind = painter.paint(points.position_m - step_m * direction).height_m
        slope += ((ahead - behind) / (2 * step_m))[:, None] * direction
    steep = np.linalg.norm(slope, axis=1, keepdims=True)
    return unit(normal - strength * slope / (1 + 0.6 * steep))


def depth_tint(light: BakedLight, albedo: np.ndarray) -> np.ndarray:
    """(N, 3) factor for light that bounced in folds: the tighter the fold, the redder, never gray (Jimenez 2016)."""
    v = np.clip(light.openness, 0.05, 1)[:, None]
    bounced = np.maximum(
        v, ((v * (2.0404 * albedo - 0.3324) + (0.6417 - 4.7951 * albedo)) * v + 2.7552 * albedo + 0.6903) * v
    )
    return (bounced / v) ** 0.4


def gloss(normal: np.ndarray, bumped: np.ndarray, marks: SkinMarks, light: BakedLight, studio: Studio) -> np.ndarray:
    """Linear RGB (N, 3) of a soft highlight, as seen from in front of the palm or the back; nails are shinier."""
    # a nail is smooth: the relief of its surroundings must not glitter in it
    bumped = unit(bumped + (normal - bumped) * marks.nail[:, None])
    towards = np.sign(bumped[:, 2:]) * np.array([[0.0, 0.15, 1.0]]) + 0.8 * bumped
    eye = unit(towards)
    total = np.zeros_like(bumped)
    for lamp in studio.lights:
        half = unit(eye + unit(np.array(lamp.direction)))
        cosine = np.clip((bumped * half).sum(1), 0, 1)
        skin, plate = 0.020 * cosine**18, 0.14 * cosine**60
        total += (skin * (1 - marks.nail) + plate * marks.nail)[:, None] * np.array(lamp.rgb)
    return total * smoothstep(0.3, 0.9, light.openness)[:, None]


def display(radiance: np.ndarray) -> np.ndarray:
    """Linear radiance (N, 3) -> display-referred sRGB 0..1, the brightest tenth rolled off instead of clipped."""
    knee = 0.80
    over = np.maximum(radiance - knee, 0)
    rolled = np.minimum(radiance, knee) + (1 - knee) * (1 - np.exp(-over / (1 - knee)))
    return linear_to_srgb(np.clip(rolled, 0, 1))
