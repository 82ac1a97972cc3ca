"""The light of a scene from a file."""

import json
from dataclasses import fields

import numpy as np
import pytest

from jghand_engine.avatar.scene_light import Lamp, harmonics
from jghand_engine.errors import InputError
from jghand_engine.export.light_file import files_of, lamp_of_words, read_light
from jghand_engine.native.scene_light_task import LampKind

LAMPS = (
    Lamp(LampKind.SUN, (3, 2, 1), (0.2, 0.5, 1), angle_rad=0.1),
    Lamp(LampKind.SPOT, (1, 1, 1), (0, 1, 0), (0, -1, 0), radius_m=0.1, is_soft=False, cone_rad=1, blend=0.5),
    Lamp(LampKind.AREA, (1, 1, 1), (0, 1, 0), size_m=(0.2, 0.1), is_ellipse=True, spread_rad=2, on_gloss=False),
)


def written(tmp_path, **content):
    path = tmp_path / "light.json"
    path.write_text(json.dumps({"format": "jghand-light", "version": 1, **content}))
    return path


def record_of(lamp):
    """A lamp as a record, without what is as usual."""
    record = {"kind": lamp.kind.name.lower()}
    for field in fields(Lamp)[1:]:
        value = getattr(lamp, field.name)
        if value != field.default:
            record[field.name] = value
    return record


def test_lamps_come_back_as_they_were_written(tmp_path):
    light = read_light(written(tmp_path, lamps=[record_of(lamp) for lamp in LAMPS]))
    assert light.lamps == LAMPS
    assert light.world is None


def test_the_sky_of_a_panorama_lights_what_looks_up(tmp_path):
    sky = np.zeros((16, 32, 3), np.float32)
    sky[:8] = (1, 2, 3)
    np.save(tmp_path / "sky.npy", sky)
    for path in (tmp_path / "sky.npy", written(tmp_path, world={"picture": "sky.npy"})):
        world = read_light(path).world
        assert world is not None
        direction, light = world.samples
        assert np.allclose(light.sum((0, 1)), 2 * np.pi * np.array([1, 2, 3]), rtol=1e-3)
        assert (direction[light.sum(-1) > 0] @ [0, 1, 0] > 0).all()
        assert tmp_path / "sky.npy" in files_of(path)


def test_a_world_of_one_color_lights_all_normals_alike(tmp_path):
    world = read_light(written(tmp_path, world={"rgb": [0.2, 0.5, 1.0]})).world
    assert world is not None
    terms = world.terms
    normals = np.random.default_rng(0).standard_normal((200, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    lit = harmonics(normals) @ terms.irradiance(np.full(3, 0.02))
    np.testing.assert_allclose(lit, np.tile(np.pi * np.array([0.2, 0.5, 1.0]), (200, 1)), rtol=0.002)


def test_a_world_of_one_color_is_as_bright_everywhere(tmp_path):
    world = read_light(written(tmp_path, world={"rgb": [0.1, 0.2, 0.3]})).world
    assert world is not None
    assert np.allclose(world.radiance, [0.1, 0.2, 0.3])


@pytest.mark.parametrize(
    "content",
    [
        {"version": 2},
        {"lamp": []},
        {"world": {"rgb": [1, 1, 1], "strength": 2}},
        {"lamps": "sun"},
        {"world": {}},
        {"world": {"picture": "no.hdr"}},
        {"world": {"rgb": [-1, 0, 0]}},
    ],
)
def test_what_is_no_light_is_refused(tmp_path, content):
    with pytest.raises(InputError):
        read_light(written(tmp_path, **content))


# ---- lamps in one line -----------------------------------------------------------------------------------------------

SUN = "sun:rgb=3/2/1,place=0.2/0.5/1,angle=0.1"
SPOT = "spot:rgb=1/1/1,place_m=0/1/0,axis=0/-1/0,radius=0.1,is_soft=false,cone=1,blend=0.5"
AREA = "area:rgb=1/1/1,place=0/1/0,size=0.2/0.1,is_ellipse=true,spread_rad=2,on_gloss=false"


def test_a_lamp_in_one_line_is_that_of_a_file(tmp_path):
    assert tuple(map(lamp_of_words, (SUN, SPOT, AREA))) == LAMPS
    world = {"rgb": [0.2, 0.5, 1.0]}
    beside = read_light(written(tmp_path, world=world, lamps=[record_of(LAMPS[0])]), LAMPS[1:])
    assert beside.lamps == read_light(written(tmp_path, world=world, lamps=[record_of(lamp) for lamp in LAMPS])).lamps
    assert beside.world is not None


@pytest.mark.parametrize(
    ("words", "record"),
    [
        ("sunn:rgb=1/1/1,place=0/1/0", {"kind": "sunn", "rgb": [1, 1, 1], "place_m": [0, 1, 0]}),
        ("sun:rgb=1/1/1,place=0/1/0,angel=1", {"kind": "sun", "rgb": [1, 1, 1], "place_m": [0, 1, 0], "angel": 1}),
        ("sun:place=0/1/0,rgb=1/1", {"kind": "sun", "place_m": [0, 1, 0], "rgb": [1, 1]}),
        ("sun:place=0/1/0,rgb=1/1/nan", {"kind": "sun", "place_m": [0, 1, 0], "rgb": [1, 1, float("nan")]}),
        ("sun:place=0/1/0,rgb", {"kind": "sun", "place_m": [0, 1, 0], "rgb": ""}),
        ("sun:rgb=1/1/1", {"kind": "sun", "rgb": [1, 1, 1]}),
        ("point:rgb=1/1/1,place=0/1/0,radius=wide", {"kind": "point", "rgb": [1, 1, 1], "place_m": [0, 1, 0],
                                                     "radius_m": "wide"}),
        ("", {"kind": ""}),
    ],
)  # fmt: skip
def test_a_wrong_lamp_in_one_line_ends_in_the_error_of_a_file(tmp_path, words, record):
    with pytest.raises(InputError) as told:
        lamp_of_words(words)
    with pytest.raises(InputError) as of_file:
        read_light(written(tmp_path, lamps=[record]))
    assert told.value.wanted == of_file.value.wanted
    assert f"in --lamp {words}" in str(told.value)
