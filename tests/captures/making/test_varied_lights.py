"""`jghand capture --lights varied`, with a stand-in for Blender: the plan of the lights, resuming, what is kept for
the test, and what opening such a folder says."""

import dataclasses
import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from jghand_engine.avatar.light_records import light_of
from jghand_engine.avatar.scene_light import World
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.check_data import check_data, facts
from jghand_engine.captures.making import person_skin, worker
from jghand_engine.captures.making.lights import (
    BEHIND,
    HELD_OUT_KINDS,
    KINDS,
    VariedLight,
    lights_bytes,
    plan_lights,
    random_lamp,
)
from jghand_engine.captures.making.plan import read_plan
from jghand_engine.captures.making.skies import SKIES, sky_radiance
from jghand_engine.captures.splits import split_capture
from jghand_engine.cli import main
from jghand_engine.errors import InputError

STAND_IN = Path(__file__).with_name("stand_in_worker.py")
WORDS = (
    *("capture", "--identity", "3", "--lights", "varied", "--cameras", "7", "--close-ups", "1", "--poses", "6"),
    *("--size", "32x48", "--blender-python", sys.executable, "--subdivisions", "0"),
)


@pytest.fixture(scope="module", autouse=True)
def _stand_in():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "find_program", lambda: STAND_IN)
        patch.setattr(person_skin, "MAP_PX", 128)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("varied") / "made"
    assert main([*WORDS, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def copied(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copied"))


def test_every_picture_has_a_world_and_two_lamps_of_its_own(made):
    lights = [sample.light for sample in open_capture(made).samples if sample.light is not None]
    assert len(lights) == 42
    assert all(light.world is not None and len(light.lamps) == 2 for light in lights)
    places = {lamp.place_m for light in lights for lamp in light.lamps}
    turns = {light.world.env_from_world.tobytes() for light in lights if light.world is not None}
    assert (len(places), len(turns)) == (84, 42)


def test_the_light_of_a_picture_is_what_drawing_makes_of_its_record(made):
    """The suns of its world with it, turned as the world is, and as much light as the plan's picture has."""
    pictures = json.loads((made / "plan" / "lights.json").read_text(encoding="utf-8"))["pictures"]
    suns = 0
    for sample in open_capture(made).samples:
        record, light = pictures[f"{sample.frame}/{sample.camera_name}"], sample.light
        assert light is not None
        turn = np.array(record["world"]["env_from_world"])
        drawn = light_of((), World(np.load(made / "plan" / record["world"]["picture"]), turn))
        assert drawn.world is not None
        assert light.world is not None
        np.testing.assert_array_equal(light.world.radiance, drawn.world.radiance)
        np.testing.assert_allclose(light.world.env_from_world, turn)
        for sun, expected in zip(light.suns, drawn.lamps, strict=True):
            np.testing.assert_allclose(sun.place_m, expected.place_m, atol=1e-6)
            np.testing.assert_allclose(sun.rgb, expected.rgb)
        suns += len(light.suns)
    assert suns


def test_held_out_lights_are_never_learned_from(made):
    capture = open_capture(made)
    split = split_capture(capture)
    assert split.novel_light
    assert not any(sample.light.is_held_out for sample in split.train + split.novel_pose + split.novel_view)
    assert all(sample.light.is_held_out for sample in split.novel_light + split.novel_both)
    assert len(split.train) + len(split.test) == len(capture)
    assert list(split.categories()) == ["novel pose", "novel view", "both novel", "novel light"]
    pictures = json.loads((made / "plan" / "lights.json").read_text(encoding="utf-8"))["pictures"]
    worlds = {True: set(), False: set()}
    for picture in pictures.values():
        worlds[picture["is_held_out"]].add(Path(picture["world"]["picture"]).stem)
    assert worlds[False] <= set(VariedLight().worlds)
    assert worlds[True] <= set(VariedLight().held_out_worlds)


def test_the_same_capture_planned_again_has_the_same_lights_and_stamps(made):
    plan = read_plan(made)
    assert plan is not None
    tests = {4}, {"400003", "400009", "400010"}
    seen_by = [plan.cameras_of(pose) for pose in range(6)]
    split = plan.split()
    assert (set(split["test_frames"]["ROM_JGHAND"]), set(split["test_cameras"])) == tests

    def planned(seed: int) -> bytes:
        return lights_bytes(plan_lights(VariedLight(), plan.hand_vertices_m, seen_by, tests, seed))

    assert planned(0) == plan.files["lights.json"]
    other = dataclasses.replace(plan, files={**plan.files, "lights.json": planned(1)})
    assert not {job.stamp for job in other.jobs(made)} & {job.stamp for job in plan.jobs(made)}


def test_groups_that_are_missing_broken_or_of_another_picture_are_made_again(copied, capsys):
    every = sorted(copied.glob("images/**/*.npz"))
    before = {path: path.read_bytes() for path in every}
    every[0].unlink()
    every[1].write_bytes(before[every[1]][:-40])
    damaged = bytearray(before[every[2]])
    damaged[len(damaged) // 2] ^= 0xFF
    every[2].write_bytes(bytes(damaged))
    shutil.copy(every[4], every[3])
    left = every[0].with_name(".image0.0badcafe.npz")
    left.write_bytes(b"what a killed worker left")
    assert main([*WORDS, "--out", str(copied), "--shard", "1/1"]) == 0
    assert "4 are broken or of another plan" in capsys.readouterr().out
    assert {path: path.read_bytes() for path in every} == before
    assert not left.exists()


def test_check_data_tells_of_the_lights_and_of_groups_that_are_broken(copied):
    report = check_data(copied)
    assert "42 pictures" in facts(report)["known light"]
    assert not [finding for finding in report.findings if "light groups" in finding.text]
    broken = sorted(copied.glob("images/**/*.npz"))[7]
    broken.write_bytes(broken.read_bytes()[:-40])
    told = [finding.text for finding in check_data(copied).findings if finding.is_error]
    assert any(str(broken) in text and "Start the command" in text for text in told)


@pytest.mark.parametrize(
    ("damage", "told"),
    [
        (lambda content: content.update(format=2), "format"),
        (lambda content: content["pictures"].popitem(), "light of every picture"),
        (lambda content: first(content)["lamps"][0].update(watts=4), "watts"),
        (lambda content: first(content)["lamps"][0].update(kind="bulb"), "kind"),
        (lambda content: first(content)["lamps"][0].update(rgb=[1, -1, 1]), "rgb"),
        (lambda content: first(content)["world"].update(picture="../../../etc/hosts"), "plan's folder"),
        (lambda content: first(content)["world"].update(picture="worlds/none.npy"), "none.npy"),
        (lambda content: first(content).update(lamps=None), "a list of at most"),
    ],
)
def test_damaged_descriptions_of_the_light_are_told(copied, damage, told):
    file = copied / "plan" / "lights.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    damage(content)
    file.write_text(json.dumps(content), encoding="utf-8")
    with pytest.raises(InputError, match=told):
        open_capture(copied)


def first(content: dict) -> dict:
    return next(iter(content["pictures"].values()))


@pytest.mark.parametrize("kind", [*KINDS, *HELD_OUT_KINDS])
def test_lamps_light_what_faces_them_alike(kind):
    """2 pi W/m2 in the middle of the hand, by the table of Blender's lights, an area as the point in its middle."""
    rng = np.random.default_rng(5)
    for _ in range(20):
        lamp = random_lamp(kind, np.zeros(3), np.array([0.0, 0.0, 1.0]), rng)
        distance2 = float(np.square(lamp["place_m"]).sum())
        light = lamp["rgb"][0]
        if lamp["kind"] == "area":
            half = lamp["spread_rad"] / 2
            gain = np.tan(half) / (np.tan(half) - half) if half < 1.5 else 1.0
            light *= np.prod(lamp["size_m"]) * (np.pi / 4 if lamp["is_ellipse"] else 1) * gain
            assert abs(np.dot(lamp["axis"], lamp["side"])) < 1e-5
        if lamp["kind"] != "sun":
            light /= distance2
        assert light == pytest.approx(2 * np.pi, rel=1e-3)


def test_a_quarter_of_the_lamps_stand_behind_the_hand_and_every_small_spot_does():
    """Not counting those that happen to stand there: behind is what is within 30 degrees of the line of sight, as 6.7 %
    of all directions are."""
    rng, behind, anywhere = np.random.default_rng(6), np.array([0.0, 0.0, 1.0]), (1 - np.cos(np.radians(30))) / 2

    def behind_it(kind: str) -> float:
        places = np.array([random_lamp(kind, np.zeros(3), behind, rng)["place_m"] for _ in range(4000)])
        return float((places[:, 2] / np.linalg.norm(places, axis=1) > np.cos(np.radians(30.001))).mean())

    for kind in KINDS:
        # four standard deviations of a count of 4000
        assert (behind_it(kind) - anywhere) / (1 - anywhere) == pytest.approx(BEHIND, abs=0.03)
    assert BEHIND == 0.25
    assert behind_it("rim") == 1


@pytest.mark.parametrize("name", SKIES)
def test_skies_have_the_mean_that_worlds_have_and_their_sun(name):
    sky = SKIES[name]
    direction, light = World(sky_radiance(sky)).samples
    assert light.sum() / (3 * 4 * np.pi) == pytest.approx(1, abs=1e-3)
    elevation = np.radians(sky.sun_elevation_deg)
    disk = direction @ [np.cos(elevation), 0, np.sin(elevation)] > np.cos(np.radians(4))
    level = light.mean(-1) * np.maximum(direction[..., 2], 0)
    assert level[disk].sum() / level.sum() == pytest.approx(sky.sun_part, abs=0.12)
