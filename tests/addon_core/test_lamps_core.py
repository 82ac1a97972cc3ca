"""Which of Blender's lights become lamps; tests/blender/test_lamps.py holds what these do against Cycles."""

import math
from dataclasses import replace

import numpy as np
import pytest

from blender_addon.core.lamps import LAMPS_SENT, BlenderLight, brightest, lamps_of
from jghand_engine.avatar import light_records, world_suns

WHITE = np.ones(3)
LIGHT = BlenderLight(
    *("POINT", np.eye(4), 10.0, WHITE),
    **{"radius": 0.1, "angle": 0.2, "cone": 1.0, "blend": 0.5, "size": (0.3, 0.2)},
)  # fmt: skip
KINDS = ("SUN", "POINT", "SPOT", "AREA")


def placed(place=(0, 0, 0), scale=(1, 1, 1)) -> np.ndarray:
    matrix = np.diag([*scale, 1.0])
    matrix[:3, 3] = place
    return matrix


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
    kept = brightest(lamps, [np.zeros(3)] * len(lamps))
    assert [lamp["kind"] for lamp in kept] == ["sun", *["point"] * (LAMPS_SENT - 1)]
    assert kept[-1]["place_m"][0] == LAMPS_SENT - 1
    assert LAMPS_SENT + world_suns.SUNS_MAX <= light_records.RECORDS_MAX
    assert brightest(lamps[:9], [np.zeros(3)] * 9) == lamps[:9]
