"""Suns out of a world's picture: what its reduced form says of 200 normals, energy, rotation."""

from functools import partial
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.avatar.scene_light import World, harmonics
from jghand_engine.avatar.world_suns import SUNS_MAX, take_suns
from jghand_engine.export.light_file import read_world_picture
from jghand_engine.native.scene_light_task import LampKind

NORMALS = np.random.default_rng(0).standard_normal((200, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)
TURN = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
TURN *= np.sign(np.linalg.det(TURN))
# a cosine whose corner is hardly rounded
HARD = np.full(3, 1e-3)

# the worlds that come with Blender, where its module stands beside the engine
SHIPPED = sorted(
    (Path(__file__).parents[2] / ".envs").glob("blender/lib/*/site-packages/bpy/*/datafiles/studiolights/world/*.exr")
)


def even_world() -> World:
    return World(np.full((64, 128, 3), (0.2, 0.5, 1.0)))


def sky(rows: int = 128) -> World:
    """A blue sky, dark ground, and a warm sun of 2.5 degrees across that gives most of the light, in a haze."""
    world = World(np.zeros((rows, 2 * rows, 3)))
    direction, _ = world.samples
    towards = np.array([0.5, -0.6, 0.62]) / np.linalg.norm([0.5, -0.6, 0.62])
    cosine = direction @ towards
    above = np.clip(direction[..., 2:] * 8 + 0.5, 0, 1)
    radiance = above * (0.3, 0.5, 0.9) + (1 - above) * (0.1, 0.08, 0.06)
    radiance += np.exp((cosine[..., None] - 1) * 60) * (1.0, 0.9, 0.7)
    radiance[cosine > np.cos(np.radians(1.25))] += (4500, 4000, 3200)
    return World(radiance)


def city() -> World:
    """A dim night with three hundred lights of all strengths, most of them below the horizon."""
    rng = np.random.default_rng(2)
    radiance = np.full((128, 256, 3), 0.02)
    rows, columns = rng.integers(55, 115, 300), rng.integers(0, 256, 300)
    radiance[rows, columns] += rng.lognormal(2, 1.2, (300, 1)) * rng.uniform(0.3, 1, (300, 3))
    return World(radiance)


def irradiance(world: World) -> np.ndarray:
    """(200, 3) W/m2 of every pixel."""
    direction, light = (values.reshape(-1, 3) for values in world.samples)
    return np.maximum(NORMALS @ direction.T, 0) @ light


def of_suns(suns) -> np.ndarray:
    towards = np.array([sun.place_m for sun in suns]).reshape(-1, 3)
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    return np.maximum(NORMALS @ towards.T, 0) @ np.array([sun.rgb for sun in suns]).reshape(-1, 3)


def errors(got: np.ndarray, true: np.ndarray) -> tuple[float, float]:
    """rms and worst, parts of the mean."""
    error = (got - true) / true.mean()
    return float(np.sqrt((error**2).mean())), float(np.abs(error).max())


def of_cells(world: World) -> np.ndarray:
    return np.maximum(NORMALS @ world.terms.direction.T, 0) @ world.terms.light


@pytest.mark.parametrize(("world", "count"), [(even_world(), 0), (sky(), 1), (city(), None)])
def test_a_world_and_its_suns_are_as_much_light_as_before(world, count):
    rest, suns = take_suns(world)
    assert len(suns) == count if count is not None else 0 < len(suns) <= SUNS_MAX
    assert (rest is world) == (not suns)
    before, after = (each.samples[1].sum((0, 1)) for each in (world, rest))
    np.testing.assert_allclose(after + np.sum([sun.rgb for sun in suns], 0), before, rtol=1e-6)
    assert errors(irradiance(rest) + of_suns(suns), irradiance(world))[1] < 0.01


def shipped(path: Path) -> World:
    pytest.importorskip("OpenEXR")
    return World(read_world_picture(path))


NONE = pytest.mark.skip(reason="no worlds of Blender: its module is not set up beside the engine")
WORLDS = [pytest.param(make, id=make.__name__) for make in (even_world, sky, city)]
WORLDS += [pytest.param(partial(shipped, path), id=path.stem) for path in SHIPPED] or [pytest.param(sky, marks=NONE)]


@pytest.mark.parametrize("make", WORLDS)
def test_cells_and_harmonics_hold_what_suns_leave(make):
    """Bounds: the worst of the worlds that Blender ships, RELIGHTING 5."""
    world = make()
    rest, suns = take_suns(world)
    true = irradiance(world)
    for got, bounds in (
        (of_cells(rest), (0.016, 0.065)),
        (harmonics(NORMALS) @ rest.terms.irradiance(HARD), (0.0465, 0.115)),
    ):
        rms, worst = errors(got + of_suns(suns), true)
        assert rms < bounds[0]
        assert worst < bounds[1]


def test_a_sun_left_in_is_what_harmonics_cannot_hold():
    """Else there were nothing to take out."""
    world = sky()
    assert errors(harmonics(NORMALS) @ world.terms.irradiance(HARD), irradiance(world))[1] > 0.115


def test_a_sun_is_where_it_was_and_as_wide():
    _, (sun,) = take_suns(sky())
    assert sun.kind is LampKind.SUN
    towards = np.array(sun.place_m) / np.linalg.norm(sun.place_m)
    away = np.degrees(np.arccos(towards @ [0.5, -0.6, 0.62] / np.linalg.norm([0.5, -0.6, 0.62])))
    # the picture's pixels are 1.4 degrees wide
    assert away < 0.4
    assert 2 < np.degrees(sun.angle_rad) < 3


def test_a_world_that_turns_takes_its_suns_along():
    world = sky()
    rest, (sun,) = take_suns(world)
    # a joint's axis d is the picture's TURN d
    turned_rest, (turned,) = take_suns(World(world.radiance, TURN))
    np.testing.assert_array_equal(turned_rest.radiance, rest.radiance)
    np.testing.assert_allclose(TURN @ turned.place_m, sun.place_m, rtol=1e-9)
    assert turned.rgb == pytest.approx(sun.rgb, rel=1e-9)
    assert turned.angle_rad == pytest.approx(sun.angle_rad, rel=1e-6)


def test_a_black_world_has_no_suns():
    black = World(np.zeros((8, 16, 3)))
    assert take_suns(black) == (black, ())
