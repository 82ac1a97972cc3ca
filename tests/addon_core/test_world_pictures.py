"""What a light probe makes of what it sees, in plain numbers; tests/blender/test_worlds.py holds it against Cycles."""

import numpy as np
import pytest

from blender_addon.core import worlds

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


def measured(picture: np.ndarray, *, missed: float) -> worlds.WorldLight:
    """A probe of a picture of its own size. missed: what mirrors see of bright pixels."""
    probe = worlds.probe()
    seen = np.where(picture > 10, picture * missed, picture).reshape(-1, 3)
    white = irradiance(picture, probe.normal[len(seen) :])
    return worlds.measured(probe, np.concatenate([seen, white / np.pi]))


def sky() -> np.ndarray:
    up = towards(worlds.PROBE_ROWS)[:, 2:]
    return (np.clip(up * 4, 0, 1) * (0.4, 0.6, 1.0) + 0.2).reshape(worlds.PROBE_ROWS, -1, 3)


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
