"""A person's nine numbers, and the colors that follow."""

import dataclasses
import json

import numpy as np
import pytest

from jghand_engine.captures.skin.person import MONK_MELANIN, MONK_SRGB, RANGES, Person, reflectance
from jghand_engine.color import linear_to_srgb
from jghand_engine.errors import InputError

# amounts of melanin, blood and carotene that come nearest to the swatches 4 to 8 of the Monk scale, by least squares
NEAREST = {4: (0.04, 0, 0.42), 5: (0.14, 0, 0.56), 6: (0.47, 0, 0.30), 7: (0.71, 0, 0), 8: (1.06, 0, 0)}


def test_every_pigment_darkens_every_channel():
    amounts = np.linspace(0, 2, 21)
    for pigment in range(3):
        rgb = reflectance(*(amounts if k == pigment else np.full(21, 0.2) for k in range(3)))
        assert (np.diff(rgb, axis=0) < 0).all()
        assert 0 < rgb.min() < rgb.max() < 0.95


@pytest.mark.parametrize(("swatch", "amounts"), NEAREST.items())
def test_the_law_of_color_meets_the_monk_scale(swatch, amounts):
    wanted = [int(MONK_SRGB[swatch - 1][k : k + 2], 16) for k in (0, 2, 4)]
    came = 255 * linear_to_srgb(reflectance(*np.array(amounts, float)))
    # observed 2, 1, 3, 5, 10
    assert np.abs(came - wanted).max() < 11


def test_the_ten_tones_are_drawn_and_darken_one_by_one():
    tones = reflectance(np.array(MONK_MELANIN), np.full(10, 0.42), np.full(10, 0.1))
    assert (np.diff(tones, axis=0) < 0).all()
    assert {Person.drawn(seed).melanin for seed in range(100)} == set(MONK_MELANIN)


def test_a_seed_draws_the_same_person_and_another_seed_another():
    assert Person.drawn(7) == Person.drawn(7)
    assert dataclasses.replace(Person.drawn(8), seed=7) != Person.drawn(7)
    for seed in range(50):
        Person.drawn(seed).check()


def test_every_second_person_that_is_drawn_has_hair():
    hair = np.array([Person.drawn(seed).hair for seed in range(200)])
    assert 0.4 < (hair > 0).mean() < 0.6
    assert 0.4 < hair[hair > 0].mean() < 0.6


def test_a_file_gives_some_of_the_numbers(tmp_path):
    (tmp_path / "ann.json").write_text(json.dumps({"melanin": 0.9, "age": 1, "seed": 4}))
    assert Person.of_file(tmp_path / "ann.json") == Person(melanin=0.9, age=1, seed=4)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ({"age": 1.5}, "age: wanted 0 to 1"),
        ({"hight": 1}, "hight"),
        ({"seed": 0.5}, "whole number"),
        ({"blood": "red"}, "blood"),
        ([], "object"),
    ],
)
def test_a_file_that_describes_no_person_is_refused(tmp_path, content, told):
    (tmp_path / "no.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=told):
        Person.of_file(tmp_path / "no.json")


def test_the_ranges_are_those_of_the_numbers_and_hold_the_defaults():
    assert list(RANGES) == [field.name for field in dataclasses.fields(Person)]
    Person().check()
