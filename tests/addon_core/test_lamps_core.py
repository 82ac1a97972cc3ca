"""Blender's lights become lamps that the engine takes: axes, meters, and what lights nothing."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from blender_addon.core.lamps import LAMPS_SENT, BlenderLight, brightest, lamps_of
from blender_addon.core.view import LIGHT_FROM_WORLD
from jghand_engine.avatar import light_records, world_suns
from jghand_engine.errors import InputError
from jghand_engine.json_files import JsonObject

WHITE = np.ones(3)
LIGHT = BlenderLight(
    *("POINT", np.eye(4), 10.0, WHITE),
    **{"radius": 0.1, "angle": 0.2, "cone": 1.0, "blend": 0.5, "size": (0.3, 0.2)},
)  # fmt: skip
KINDS = ("SUN", "POINT", "SPOT", "AREA")


def wrong(name: str, wanted: str, came: object) -> InputError:
    return InputError(name, wanted=wanted, came=repr(came))


def placed(place=(0, 0, 0), turn=None, scale=(1, 1, 1)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = (np.eye(3) if turn is None else turn) * np.array(scale, float)
    matrix[:3, 3] = place
    return matrix


# turns the lamp, which shines down, to shine along +y of Blender: away from who looks from the front
AWAY = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])


@pytest.mark.parametrize("kind", KINDS)
def test_the_engine_takes_every_lamp_as_json(kind):
    lamps = json.loads(json.dumps(lamps_of(replace(LIGHT, kind=kind, gloss=0.5), 1.0)))
    read = light_records.lamps_of(JsonObject({"lamps": lamps}, wrong))
    assert [lamp.on_matt for lamp in read] == [True, False]


def test_lamps_stand_and_shine_in_the_axes_of_the_engine():
    matrix = placed((1, 2, 3), AWAY)
    (sun,) = lamps_of(replace(LIGHT, kind="SUN", matrix=matrix), 1.0)
    np.testing.assert_allclose(sun["place_m"], LIGHT_FROM_WORLD[:3, :3] @ (0, -1, 0), atol=1e-12)
    (area,) = lamps_of(replace(LIGHT, kind="AREA", matrix=matrix), 1.0)
    np.testing.assert_allclose(area["place_m"], (1, 3, -2), atol=1e-12)
    np.testing.assert_allclose(area["axis"], (0, 0, -1), atol=1e-12)
    np.testing.assert_allclose(area["side"], (1, 0, 0), atol=1e-12)


def test_the_unit_of_the_scene_moves_lamps_and_changes_no_light():
    """Blender counts units as meters, so that what a lamp does at its distance in units stays."""
    matrix = placed((3, 0, 4))
    (near,) = lamps_of(replace(LIGHT, matrix=matrix), 0.01)
    np.testing.assert_allclose(np.linalg.norm(near["place_m"]), 0.05)
    assert near["radius_m"] == pytest.approx(0.001)
    np.testing.assert_allclose(np.array(near["rgb"]) / 0.05**2, 10 / (4 * math.pi) / 25)
    (one,), (other,) = (lamps_of(replace(LIGHT, kind="AREA", matrix=matrix), unit_m) for unit_m in (1.0, 0.01))
    assert one["rgb"] == other["rgb"]
    np.testing.assert_allclose(other["size_m"], np.array(one["size_m"]) / 100)


@pytest.mark.parametrize(
    "light",
    [
        *(replace(LIGHT, kind=kind, power=power) for kind in KINDS for power in (0.0, -1.0, math.nan, math.inf)),
        *(replace(LIGHT, kind=kind, color=np.zeros(3)) for kind in KINDS),
        *(replace(LIGHT, kind=kind, matrix=placed(scale=(1, 1, 0))) for kind in ("SUN", "SPOT", "AREA")),
        replace(LIGHT, matrix=placed((math.nan, 0, 0))),
        replace(LIGHT, kind="SPOT", cone=0.0),
        replace(LIGHT, kind="AREA", size=(0.3, 0.0)),
        replace(LIGHT, kind="AREA", matrix=placed(scale=(0, 1, 1))),
        replace(LIGHT, matt=0.0, gloss=0.0),
    ],
)
def test_what_lights_nothing_is_no_lamp(light):
    assert lamps_of(light, 1.0) == []


def test_a_color_has_no_negative_part():
    (lamp,) = lamps_of(replace(LIGHT, color=np.array([1, -0.5, 0])), 1.0)
    assert lamp["rgb"][1:] == [0, 0]


def test_skin_that_scatters_and_mirrors_different_parts_gets_two_lamps():
    matt, gloss = lamps_of(replace(LIGHT, gloss=0.25), 1.0)
    assert (matt["on_gloss"], gloss["on_matt"]) == (False, False)
    np.testing.assert_allclose(gloss["rgb"], np.array(matt["rgb"]) / 4)
    (matt,) = lamps_of(replace(LIGHT, gloss=0.0), 1.0)
    assert matt["on_gloss"] is False


def test_a_spot_is_as_wide_as_the_scale_of_its_object_makes_it():
    spot = replace(LIGHT, kind="SPOT", cone=math.pi / 2, blend=1.0)
    (plain,), (even,) = (lamps_of(replace(spot, matrix=placed(scale=scale)), 1.0) for scale in ((1, 1, 1), (-3, 3, 3)))
    assert plain["cone_rad"] == pytest.approx(math.pi / 2)
    assert plain["blend"] == pytest.approx(1.0)
    assert even["cone_rad"] == pytest.approx(plain["cone_rad"])
    (long,) = lamps_of(replace(spot, matrix=placed(scale=(1, 1, 2))), 1.0)
    assert long["cone_rad"] == pytest.approx(2 * math.atan(0.5))
    (oval,) = lamps_of(replace(spot, matrix=placed(scale=(4, 1, 1))), 1.0)
    assert oval["cone_rad"] == pytest.approx(2 * math.atan(2))
    (half,) = lamps_of(replace(spot, cone=math.pi, matrix=placed(scale=(1, 1, 2))), 1.0)
    assert half["cone_rad"] == pytest.approx(math.pi)


def test_a_tiny_area_is_as_bright_as_it_is_in_numbers_that_the_engine_takes():
    for is_normalized in (True, False):
        area = replace(LIGHT, kind="AREA", size=(1e-6, 0.5), power=1e3, is_normalized=is_normalized)
        (lamp,) = lamps_of(area, 1.0)
        assert lamp["size_m"] == [1e-3, 0.5]
        power = 1e3 if is_normalized else 1e3 * 1e-6 * 0.5
        np.testing.assert_allclose(np.array(lamp["rgb"]) * 1e-3 * 0.5 * math.pi, power)
    (tiny,) = lamps_of(replace(LIGHT, kind="AREA", size=(1e-9, 1e-9), power=1e3), 1.0)
    assert max(tiny["rgb"]) < light_records.NUMBER_MAX


def test_of_many_lamps_the_engine_gets_as_many_as_it_takes_and_those_that_light_most():
    lights = [replace(LIGHT, matrix=placed((away, 0, 0))) for away in range(1, 400)]
    lights += [replace(LIGHT, kind=kind, matrix=placed((1e4, 0, 0))) for kind in ("AREA", "SUN")]
    lamps = [lamp for light in lights for lamp in lamps_of(light, 1.0)]
    kept = brightest(lamps, np.zeros(3))
    assert [lamp["kind"] for lamp in kept] == ["sun", *["point"] * (LAMPS_SENT - 1)]
    assert kept[-1]["place_m"][0] == LAMPS_SENT - 1
    assert LAMPS_SENT + world_suns.SUNS_MAX <= light_records.RECORDS_MAX
    assert brightest(lamps[:9], np.zeros(3)) == lamps[:9]
