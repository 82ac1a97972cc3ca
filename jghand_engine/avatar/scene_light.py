"""The light of a scene, scene-linear with Rec.709 primaries: a world all around and lamps in it.

    light = SceneLight(World(radiance, env_from_world), (Lamp(LampKind.SUN, ...), ...))

Units are radiometric, whatever program they came from: what a lamp's `rgb` means depends on its kind. The world is
reduced to what the skin takes of it (`WorldTerms`): 16 harmonics say how it lights a lone surface, 64 cells, each by
the centroid of its light, how much of that a hand's own fingers take, 8 lobes what skin mirrors of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from jghand_engine.avatar.learned import lamp_directions
from jghand_engine.errors import InputError
from jghand_engine.native.scene_light_task import LAMP_NUMBERS, NUMBER, LampKind

# squares of the constants that make `harmonics` orthonormal, and the degree of each
HARMONIC_NORM2 = np.square(
    [
        *(0.282095, 0.488603, 0.488603, 0.488603),
        *(1.092548, 1.092548, 1.092548, 0.546274, 0.315392),
        *(0.590044, 2.890611, 0.457046, 0.373176, 0.457046, 1.445306, 0.590044),
    ]
)
HARMONIC_DEGREE = np.repeat([0, 1, 2, 3], [1, 3, 5, 7])
# cells of the world that shadows are found for
CELLS = 64
# what the world mirrors: lobes, evenly all around, near enough to each other for skin's roughness; rounds of their fit
LOBES, LOBE_ROUNDS = 32, 200
# rows of the world that lobes are fitted to: lobes are some 30 degrees wide
LOBE_ROWS = 16
# rows of a world that is made of cells: 32 pixels each
CELL_ROWS = 32
# nodes of the integral over a rounded cosine
GAUSS_NODES = 48
# the world lights no normal with less than this part of its mean: harmonics may swing below zero
WORLD_FLOOR = 0.03
# fade of a spot without one: a step of its cosine
BLEND_MIN = 1e-3


@dataclass(frozen=True, eq=False)
class World:
    """Light from far away. One is equal to itself alone: to compare pictures would cost more than to reduce them.

    radiance:       (H, W, 3) 0 and up, W/(m2 sr), equirectangular as Blender has it: +z above the first row, +x in the
                    middle, +y a quarter to the left of it
    env_from_world: (3, 3) rotation from the axes of the joints to those of `radiance`
    """

    radiance: np.ndarray
    env_from_world: np.ndarray = field(default_factory=lambda: np.eye(3))

    def __post_init__(self) -> None:
        shape = self.radiance.shape
        if len(shape) != 3 or shape[2] != 3 or 0 in shape:
            raise InputError("world", wanted="radiance of shape (rows, columns, 3)", came=str(shape))
        if not np.isfinite(self.radiance).all() or (self.radiance < 0).any():
            raise InputError("world", wanted="finite radiance, 0 and up", came="something else")
        turn = np.asarray(self.env_from_world, np.float64)
        if turn.shape != (3, 3) or not np.allclose(turn @ turn.T, np.eye(3), atol=1e-4) or np.linalg.det(turn) < 0:
            raise InputError("world", wanted="a rotation env_from_world", came=str(turn.tolist()))

    @classmethod
    def of_cells(cls, light: np.ndarray) -> World:
        """One whose `terms.light` is `light` (CELLS, 3), each cell evenly bright; +y of the joints above its first
        row."""
        env_from_world = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
        even = cls(np.ones((CELL_ROWS, 2 * CELL_ROWS, 3)), env_from_world)
        direction, solid_angle = (values.reshape(-1, 3) for values in even.samples)
        cell = (direction @ lamp_directions(CELLS).T).argmax(1)
        whole = np.bincount(cell, solid_angle[:, 0], CELLS)
        radiance = (light / whole[:, None])[cell].reshape(even.radiance.shape)
        return cls(radiance.astype(np.float32), env_from_world)

    @cached_property
    def samples(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (H, W, 3), in the axes of the joints, and light (H, W, 3): radiance times solid angle."""
        rows, columns = self.radiance.shape[:2]
        up = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)[:, None]
        around = 2 * np.pi * (0.5 - (np.arange(columns) + 0.5) / columns)[None, :]
        env = np.stack(np.broadcast_arrays(np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)), -1)
        # of the band between two latitudes, exactly
        edges = np.sin(np.pi * (0.5 - np.arange(rows + 1) / rows))
        solid_angle = (edges[:-1] - edges[1:])[:, None, None] * (2 * np.pi / columns)
        return env @ np.asarray(self.env_from_world, np.float64), self.radiance * solid_angle

    @cached_property
    def terms(self) -> WorldTerms:
        """What skin takes of it."""
        direction, light = (values.reshape(-1, 3) for values in self.samples)
        light = light.astype(np.float64)
        coefficients = (harmonics(direction) * HARMONIC_NORM2).T @ light
        cell = (direction @ lamp_directions(CELLS).T).argmax(1)
        of_cell, centroid = np.zeros((CELLS, 3)), lamp_directions(CELLS).astype(np.float64) * 1e-9
        np.add.at(of_cell, cell, light)
        np.add.at(centroid, cell, direction * light.sum(1, keepdims=True))
        return WorldTerms(coefficients, centroid / np.linalg.norm(centroid, axis=1, keepdims=True), of_cell)


@dataclass(frozen=True)
class WorldTerms:
    """A world, reduced.

    harmonics: (16, 3) coefficients of its radiance for `harmonics`
    direction: (64, 3) unit, centroids of the cells' light
    light:     (64, 3) radiance times solid angle of the cells
    """

    harmonics: np.ndarray
    direction: np.ndarray
    light: np.ndarray

    @cached_property
    def mean_irradiance(self) -> np.ndarray:
        """(3,) W/m2, mean over all normals."""
        return self.light.sum(0) / 4

    def irradiance(self, softness: np.ndarray) -> np.ndarray:
        """(16, 3) coefficients of what a normal gets, W/m2, its cosine rounded by `softness` (3,)."""
        return self.harmonics * cosine_bands(softness)[HARMONIC_DEGREE]


@dataclass(frozen=True)
class Lamp:
    """A lamp. Places in the frame of the joints, meters.

    kind:        of it
    rgb:         (3,) 0 and up; of a sun W/m2 on what faces it, of point and spot W/sr, of an area W/(m2 sr)
    place_m:     (3,) its middle; of a sun the direction towards it, of any length
    axis:        (3,) where spot and area shine, of any length
    side:        (3,) first side of an area, at a right angle to the axis
    radius_m:    of point and spot
    is_soft:     whether a point or spot within its own radius stays finite (Blender's soft falloff)
    angle_rad:   of a sun, across
    cone_rad:    of a spot, across
    blend:       part of a spot's cone over which it fades
    size_m:      (2,) of an area, along `side` and across it
    is_ellipse:  whether an area is one
    spread_rad:  of an area, across; pi: all of the half space
    has_shadow:  whether the hand shades itself from it
    on_matt, on_gloss: which light of it counts
    hands:       numbers of the hands of an image that it lights; None: all
    """

    kind: LampKind
    rgb: tuple[float, float, float]
    place_m: tuple[float, float, float]
    axis: tuple[float, float, float] = (0.0, 0.0, -1.0)
    side: tuple[float, float, float] = (1.0, 0.0, 0.0)
    radius_m: float = 0.0
    is_soft: bool = True
    angle_rad: float = 0.0
    cone_rad: float = np.pi
    blend: float = 0.0
    size_m: tuple[float, float] = (0.0, 0.0)
    is_ellipse: bool = False
    spread_rad: float = np.pi
    has_shadow: bool = True
    on_matt: bool = True
    on_gloss: bool = True
    hands: tuple[int, ...] | None = None

    def __post_init__(self) -> None:
        numbers = np.array([*self.rgb, *self.place_m, *self.axis, *self.side, self.radius_m, *self.size_m], np.float64)
        angles = np.array([self.angle_rad, self.cone_rad, self.blend, self.spread_rad], np.float64)
        if not (np.isfinite(numbers).all() and np.isfinite(angles).all()):
            raise InputError("lamp", wanted="finite numbers", came="others")
        if min(*self.rgb, self.radius_m, *self.size_m, *angles.tolist()) < 0:
            raise InputError("lamp", wanted="light, sizes and angles of 0 and up", came="negative ones")
        # the sun's direction is its place
        if not np.any(self.place_m if self.kind is LampKind.SUN else self.axis):
            raise InputError("lamp", wanted="a direction", came="none")

    @cached_property
    def numbers(self) -> np.ndarray:
        """(LAMP_NUMBERS,) as the kernel takes it, in the frame of the joints, without a shadow."""
        place, axis, rgb = (np.array(value, np.float64) for value in (self.place_m, self.axis, self.rgb))
        is_sun = self.kind is LampKind.SUN
        row = np.zeros(len(LAMP_NUMBERS))
        row[:3] = place / np.linalg.norm(place) if is_sun else place
        row[3:6] = axis / max(float(np.linalg.norm(axis)), 1e-12)
        values = {"kind": self.kind, "slot": -1, "on_matt": self.on_matt, "on_gloss": self.on_gloss}
        if is_sun:
            values["sun_sine"] = np.sin(min(self.angle_rad, np.pi) / 2)
        elif self.kind is LampKind.AREA:
            area_m2 = self.size_m[0] * self.size_m[1] * (np.pi / 4 if self.is_ellipse else 1.0)
            # far away radiance times area is what a point sends; near, a disk of the same area
            rgb, values["softening"] = rgb * area_m2, area_m2 / np.pi
            values["radius2"] = area_m2 / np.pi
            half = min(self.spread_rad / 2, np.pi / 2)
            if half < np.pi / 2 - 1e-3:
                # all light in an ever narrower beam: a thousandth is none
                half = max(half, 1e-3)
                values["spread"], values["spread_gain"] = np.tan(half), 1 / (np.tan(half) - half)
        else:
            values["radius2"] = self.radius_m**2
            values["softening"] = self.radius_m**2 if self.is_soft else 0.0
        if self.kind is LampKind.SPOT:
            cone = np.cos(min(self.cone_rad, 2 * np.pi) / 2)
            values["cone"], values["cone_scale"] = cone, 1 / max((1 - cone) * self.blend, BLEND_MIN * BLEND_MIN)
        row[6:9] = rgb
        for name, value in values.items():
            row[NUMBER[name]] = value
        return row

    def on_hand(self, place: int) -> Lamp:
        """As it lights one hand of an image: black where it lights others alone."""
        is_lit = self.hands is None or place in self.hands
        return replace(self, rgb=self.rgb if is_lit else (0.0, 0.0, 0.0), hands=None)

    @cached_property
    def sides(self) -> np.ndarray:
        """(2, 3) unit: the first side of an area, at a right angle to its axis, and the one across."""
        axis, side = self.numbers[3:6], np.array(self.side, np.float64)
        side = side - (side @ axis) * axis
        side /= max(float(np.linalg.norm(side)), 1e-12)
        return np.stack([side, np.cross(axis, side)])


@dataclass(frozen=True, eq=False)
class Shades:
    """What the things of a scene leave of its lamps on the hands of an image. One is equal to itself alone.

    left: for each hand (lamps, anchors) 0..1, in the orders of the light's lamps and of the anchors of the avatar's
          cast shadow; lamps beyond the rows have all of it
    """

    left: tuple[np.ndarray, ...]


@dataclass(frozen=True, eq=False)
class Baked:
    """All light that reaches the matt skin of the hands of an image, as a path tracer found it in their scene: in place
    of world and lamps, which skin still mirrors. One is equal to itself alone.

    field: for each hand (N, 4, 3) W/m2 in the order of the avatar's Gaussians, of which a prefix is drawn: a surface of
           unit normal n gets [0] + n @ [1:], and nothing where that is negative
    """

    field: tuple[np.ndarray, ...]


@dataclass(frozen=True)
class SceneLight:
    """All light of a scene. world: None for a black one. shades: None where nothing stands in the light. baked: None
    where skin is lit by lamps and world."""

    world: World | None = None
    lamps: tuple[Lamp, ...] = ()
    shades: Shades | None = None
    baked: Baked | None = None

    @cached_property
    def lamp_numbers(self) -> np.ndarray:
        """(lamps, LAMP_NUMBERS) of its lamps, as `Lamp.numbers` has them."""
        return np.array([lamp.numbers for lamp in self.lamps]).reshape(-1, len(LAMP_NUMBERS))

    @cached_property
    def _on_hands(self) -> dict[int, SceneLight]:
        return {}

    def on_hand(self, place: int) -> SceneLight:
        """As it falls on one hand of an image, each time the very same: lamps that light others alone are black."""
        if self.shades is None and self.baked is None and all(lamp.hands is None for lamp in self.lamps):
            return self
        if place not in self._on_hands:
            self._on_hands[place] = replace(
                self,
                lamps=tuple(lamp.on_hand(place) for lamp in self.lamps),
                shades=self.shades and Shades(self.shades.left[place : place + 1]),
                baked=self.baked and Baked(self.baked.field[place : place + 1]),
            )
        return self._on_hands[place]


def harmonics(direction: np.ndarray) -> np.ndarray:
    """(N, 16) real spherical harmonics, degrees 0 to 3, without constants, of unit vectors (N, 3)."""
    x, y, z = np.moveaxis(direction.astype(np.float64), -1, 0)
    xx, yy, zz = x * x, y * y, z * z
    return np.stack(
        [
            np.ones_like(x), x, y, z,
            x * y, y * z, z * x, xx - yy, 3 * zz - 1,
            y * (3 * xx - yy), x * y * z, y * (5 * zz - 1), z * (5 * zz - 3), x * (5 * zz - 1), z * (xx - yy),
            x * (xx - 3 * yy),
        ],
        -1,
    )  # fmt: skip


def soft_cosine(cosine: np.ndarray, width: np.ndarray) -> np.ndarray:
    """max(cosine, 0) with its corner rounded over |cosine| < width; 0 below: light does not leak to the far side."""
    rounded = np.square(cosine + width) / (4 * width)
    return np.where(cosine >= width, cosine, np.where(cosine <= -width, 0.0, rounded))


def cosine_bands(softness: np.ndarray) -> np.ndarray:
    """(4, C) what a rounded cosine keeps of each degree of harmonics, so that an even world gives pi. softness: (C,)"""
    node, weight = np.polynomial.legendre.leggauss(GAUSS_NODES)
    legendre = np.stack([np.ones_like(node), node, 1.5 * node**2 - 0.5, 2.5 * node**3 - 1.5 * node])
    bands = 2 * np.pi * legendre @ (weight[:, None] * soft_cosine(node[:, None], np.asarray(softness)[None, :]))
    return bands * (np.pi / bands[0])


def mirrored_lobes(world: World, sharpness: float) -> np.ndarray:
    """(LOBES, 7) spherical Gaussians, direction, sharpness, radiance, whose sum is the world blurred by one of
    `sharpness`."""
    direction, light = (values.reshape(-1, 3).astype(np.float64) for values in world.samples)
    middle, _ = World(np.ones((LOBE_ROWS, 2 * LOBE_ROWS, 3)), world.env_from_world).samples
    middle = middle.reshape(-1, 3)
    kernel = np.exp(sharpness * (middle @ direction.T - 1))
    evenly = 2 * np.pi / sharpness * -np.expm1(-2 * sharpness)
    blurred = kernel @ light / evenly
    towards = lamp_directions(LOBES)
    shape = np.exp(sharpness * (middle @ towards.T - 1))
    # non-negative least squares by multiplicative updates: Lee and Seung, 2001
    rgb = np.full((LOBES, 3), blurred.mean() + 1e-12)
    for _ in range(LOBE_ROUNDS):
        rgb *= (shape.T @ blurred) / np.maximum(shape.T @ (shape @ rgb), 1e-12)
    return np.concatenate([towards, np.full((LOBES, 1), sharpness), rgb], 1)
