"""Pictures of worlds in plain numbers: averaging, and what a light probe makes of what it sees."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon.core import worlds
from blender_addon.core.view import LIGHT_FROM_WORLD

NORMALS = np.random.default_rng(0).standard_normal((60, 3))
NORMALS /= np.linalg.norm(NORMALS, axis=1, keepdims=True)


def solid_angles(rows: int) -> np.ndarray:
    edges = np.sin(np.linspace(np.pi / 2, -np.pi / 2, rows + 1))
    return np.repeat(edges[:-1] - edges[1:], 2 * rows) * np.pi / rows


def towards(rows: int) -> np.ndarray:
    up = np.pi * (0.5 - (np.arange(rows) + 0.5) / rows)
    return worlds.directions(up, np.pi * (1 - (np.arange(2 * rows) + 0.5) / rows)).reshape(-1, 3)


def irradiance(picture: np.ndarray, normals: np.ndarray) -> np.ndarray:
    rows = len(picture)
    light = picture.reshape(-1, 3) * solid_angles(rows)[:, None]
    return np.maximum(normals @ towards(rows).T, 0) @ light


def test_a_picture_lies_as_blender_lays_it():
    """+z above the first row, +x in the middle, +y a quarter to the left of it."""
    where = towards(64).reshape(64, 128, 3)
    np.testing.assert_allclose(where[0, 0], [0, 0, 1], atol=0.03)
    np.testing.assert_allclose(where[31:33, 63:65].mean((0, 1)), [1, 0, 0], atol=0.01)
    np.testing.assert_allclose(where[31:33, 31:33].mean((0, 1)), [0, 1, 0], atol=0.01)


def test_a_record_turns_the_joints_axes_into_the_pictures():
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    record = worlds.WorldLight(np.ones((2, 4, 3)), turn, key="name").record
    in_blender = np.array([0.1, 0.5, 0.8])
    in_joints = LIGHT_FROM_WORLD[:3, :3] @ in_blender
    np.testing.assert_allclose(np.array(record["env_from_world"]) @ in_joints, turn @ in_blender)
    assert record["key"] == "name"


@pytest.mark.parametrize("shape", [(600, 1300), (256, 512), (20, 3000)])
def test_averaging_keeps_light(shape):
    picture = np.random.default_rng(1).lognormal(0, 1, (*shape, 3)).astype(np.float32)
    small = worlds.averaged(picture)
    assert small.shape == (min(shape[0], 256), min(shape[1], 512), 3)
    bands = [np.diff(-np.sin(np.linspace(np.pi / 2, -np.pi / 2, len(each) + 1))) for each in (picture, small)]
    powers = [np.einsum("r,rc->c", band, each.mean(1)) for band, each in zip(bands, (picture, small), strict=True)]
    np.testing.assert_allclose(powers[1], powers[0], rtol=1e-5)


def measured(picture: np.ndarray, sun: worlds.Sun | None = None, power: float = 0.0, *, missed: float = 1.0):
    """A probe of a picture of its own size and of a sun. missed: what mirrors see of bright pixels."""
    probe = worlds.probe(sun)
    count = 2 * worlds.PROBE_ROWS**2
    seen = np.where(picture > 10, picture * missed, picture).reshape(-1, 3)
    normal = probe.normal[count : count + probe.whites]
    white = irradiance(picture, normal)
    out = [seen, white / np.pi]
    if sun is not None:
        disc = power / (2 * np.pi * (1 - np.cos(sun.angle_rad / 2)))
        out[0] = np.where((towards(worlds.PROBE_ROWS) @ sun.towards > np.cos(sun.angle_rad / 2))[:, None], disc, seen)
        out[1] = (white + np.maximum(normal @ sun.towards, 0)[:, None] * power) / np.pi
        out.append(np.full((len(probe.normal) - len(normal) - count, 3), disc))
    return worlds.measured(probe, np.concatenate(out))


def sky() -> np.ndarray:
    up = towards(worlds.PROBE_ROWS)[:, 2:]
    return (np.clip(up * 4, 0, 1) * (0.4, 0.6, 1.0) + 0.2).reshape(worlds.PROBE_ROWS, -1, 3)


def test_what_mirrors_and_white_facets_agree_on_stays():
    light = measured(sky())
    np.testing.assert_allclose(light.radiance, sky(), rtol=0.05)
    assert light.suns == ()


@pytest.mark.parametrize("missed", [0.0, 0.3, 4.0])
def test_white_facets_say_how_bright_what_mirrors_missed_is(missed):
    picture = sky()
    picture[8, 20] = (900, 800, 600)
    light = measured(picture, missed=missed)
    true = irradiance(picture, NORMALS)
    error = np.abs(irradiance(light.radiance, NORMALS) - true) / true.mean()
    # what was not seen may be anywhere in its part
    assert error.max() < (0.06 if missed else 0.12)
    if missed:
        assert np.unravel_index(light.radiance[..., 0].argmax(), light.radiance.shape[:2]) == (8, 20)


@pytest.mark.parametrize("angle_rad", [0.01, 0.3])
def test_a_sun_is_a_lamp_and_no_part_of_the_picture(angle_rad):
    place = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    light = measured(sky(), worlds.Sun(place, angle_rad), power=3.0)
    (sun,) = light.suns
    np.testing.assert_allclose(sun["rgb"], 3.0, rtol=1e-6)
    np.testing.assert_allclose(sun["place_m"], LIGHT_FROM_WORLD[:3, :3] @ place)
    np.testing.assert_allclose(light.radiance, sky(), rtol=0.05)


def test_facets_do_not_hide_one_another():
    """On the ball they are farther apart than they are large, and those for a sun lie in one plane across it."""
    place = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    probe = worlds.probe(worlds.Sun(place, 0.3))
    is_ball = np.arange(len(probe.place)) < 2 * worlds.PROBE_ROWS**2 + probe.whites
    ball, size = probe.place[is_ball], probe.size[is_ball]
    for each in range(0, len(ball), 50):
        away = np.linalg.norm(ball - ball[each], axis=1)
        away[each] = np.inf
        assert (away > size + size[each]).all()
    plane = probe.place[~is_ball]
    assert np.ptp(plane @ place) < 1e-9
    apart = np.linalg.norm(plane[:, None] - plane[None], axis=-1) + np.eye(len(plane))
    assert apart.min() > 2 * probe.size[-1]
    assert np.linalg.norm(plane, axis=1).min() > 2
