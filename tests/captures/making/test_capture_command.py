"""`jghand capture` from end to end with a stand-in for Blender: plan, pictures, resuming, shards, splits, failures."""

import dataclasses
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from waiting import wait_until

from jghand_engine import __version__
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.making import person_skin, worker
from jghand_engine.captures.making.close_ups import CLOSE_PX, CLOSE_SAMPLES
from jghand_engine.captures.making.options import CaptureOptions, Light, Sampling
from jghand_engine.captures.making.plan import CapturePlan, make_plan, open_or_make, read_plan
from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.splits import split_capture
from jghand_engine.cli import main
from jghand_engine.errors import InputError, RetryError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.rotations import alignment
from jghand_engine.hand.sequence import PoseSequence, forearm_turns
from jghand_engine.template.builtin import load_template

ROOT = Path(__file__).resolve().parents[3]
# a coarse mesh, and few texels on it
MAP_PX, COARSE = 128, Sampling(subdivisions=0)
WORDS = [
    "capture", "--identity", "3", "--subdivisions", "0", "--cameras", "7", "--close-ups", "1", "--poses", "6",
    "--size", "32x48",
]  # fmt: skip

STAND_IN = Path(__file__).with_name("stand_in_worker.py")
FIND_PROGRAM = worker.find_program


@pytest.fixture(autouse=True)
def _stand_in(monkeypatch):
    monkeypatch.setattr(worker, "find_program", lambda: STAND_IN)
    monkeypatch.setattr(person_skin, "MAP_PX", MAP_PX)


def capture(folder: Path, *words: str) -> int:
    return main([*WORDS, "--out", str(folder), "--blender-python", sys.executable, *words])


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    """One whole capture, to be copied."""
    folder = tmp_path_factory.mktemp("capture") / "made"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(worker, "find_program", lambda: STAND_IN)
        patch.setattr(person_skin, "MAP_PX", MAP_PX)
        assert capture(folder) == 0
    return folder


@pytest.fixture
def copied(made, tmp_path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "copied"))


def pictures(folder: Path) -> list[Path]:
    return sorted(folder.glob("images/**/*.png"))


def test_a_capture_opens_as_a_data_set_with_exact_cameras_and_joints(made):
    plan = read_plan(made)
    assert plan is not None
    capture = open_capture(made)
    assert len(capture.samples) == 42
    # so that a hand that is learned from it has one
    assert capture.shows_forearm
    names = list(plan.record.cameras)
    for sample in capture.samples:
        camera = plan.cameras[names.index(sample.camera_name)].camera
        # millimeters in between: observed 1e-16 m and 1e-13
        np.testing.assert_allclose(sample.joints_m, plan.joints_m[sample.frame], atol=1e-15)
        difference = sample.camera.camera_from_world - camera.camera_from_world
        assert float(np.abs(difference).max()) < 1e-12
        assert (sample.camera.fx, sample.camera.cx, sample.camera.cy) == (camera.fx, camera.cx, camera.cy)
        assert sample.handedness is Handedness.RIGHT


def test_every_picture_tells_how_its_forearm_is_turned(made):
    plan, hand = read_plan(made), RiggedHand(load_identity("3", forearm=True))
    assert plan is not None
    assert plan.forearm is not None
    # it went with the wrist: where that was turned to, the end of the forearm says, by least squares
    end = hand.identity.vertices_m[-17:]
    wrist = alignment(end - end.mean(0), plan.vertices_m[:, -17:] - plan.vertices_m[:, -17:].mean(1, keepdims=True))
    wanted = forearm_turns(plan.joints_m, hand.identity.joints_m, wrist)
    for sample in open_capture(made).samples:
        assert sample.hand.joints_m is sample.joints_m
        # single precision of the vertices: worst observed 3.2e-8
        assert sample.hand.forearm is not None
        np.testing.assert_allclose(sample.hand.forearm, wanted[sample.frame], atol=2e-7)
    # the palm arches with the knuckles: observed 8.5 degrees
    assert np.degrees(2 * np.arccos(plan.forearm[:, 0].min())) > 5


def test_a_capture_from_before_goes_on_and_knows_no_turn_of_the_forearm(copied, capsys):
    file = copied / "plan" / "hands.npz"
    with np.load(file) as hands:
        before = {name: hands[name] for name in hands.files if name != "forearm"}
    np.savez_compressed(file, **before)
    assert capture(copied) == 0
    assert "0 pictures" in capsys.readouterr().out
    opened = open_capture(copied)
    assert opened.shows_forearm
    assert [sample.hand.forearm for sample in opened.samples] == [None] * len(opened)


@pytest.mark.parametrize("turns", [np.ones((5, 4)), np.ones((6, 3)), np.zeros((6, 4))])
def test_turns_of_the_forearm_that_are_none_are_refused(copied, turns):
    file = copied / "plan" / "hands.npz"
    with np.load(file) as hands:
        np.savez_compressed(file, **{**hands, "forearm": turns})
    with pytest.raises(InputError, match="forearm"):
        open_capture(copied)


def test_whole_views_and_close_ups_have_sizes_of_their_own_and_a_close_up_sees_one_pose(made):
    samples = open_capture(made).samples
    sizes = {one.camera_name: (one.camera.width, one.camera.height) for one in samples}
    close_ups = [one.camera_name for one in samples if sizes[one.camera_name] == (CLOSE_PX, CLOSE_PX)]
    assert sorted(set(sizes.values())) == [(32, 48), (CLOSE_PX, CLOSE_PX)]
    assert (len(close_ups), len(set(close_ups)), len(sizes)) == (6, 6, 12)
    by_pose = open_capture(made).by_pose()
    assert all(len(of_pose) == 7 for of_pose in by_pose.values())
    cameras = json.loads((made / "plan" / "plan.json").read_text(encoding="utf-8"))["cameras"]
    assert [(one.get("pose"), one.get("samples")) for one in cameras] == [
        *[(None, None)] * 6, *[(pose, CLOSE_SAMPLES) for pose in range(6)]
    ]  # fmt: skip


def test_the_split_keeps_poses_and_cameras_of_both_sizes_for_the_test(made):
    split = split_capture(open_capture(made))
    frames = {sample.frame for sample in split.train}
    cameras = {sample.camera_name for sample in split.train}
    assert len(frames) == 5
    assert len(cameras) == 5 + 4
    assert all(s.frame not in frames for s in split.novel_pose)
    assert all(s.frame in frames and s.camera_name not in cameras for s in split.novel_view)
    assert (len(split.train), len(split.novel_pose), len(split.novel_view), len(split.novel_both)) == (29, 5, 6, 2)
    for held_out in (split.novel_view, split.novel_both):
        assert {sample.camera.width for sample in held_out} == {32, CLOSE_PX}


def test_a_close_up_of_a_new_pose_is_of_a_new_camera_too(made):
    split = split_capture(open_capture(made))
    learned = {sample.camera_name for sample in split.train}
    assert all(sample.camera_name in learned for sample in split.novel_pose)


def test_a_second_run_makes_nothing_again(copied, capsys):
    times = {path: path.stat().st_mtime_ns for path in pictures(copied)}
    assert capture(copied) == 0
    assert "0 pictures" in capsys.readouterr().out
    assert {path: path.stat().st_mtime_ns for path in pictures(copied)} == times


def test_missing_broken_and_foreign_pictures_are_made_again_and_no_others(copied, capsys):
    every = pictures(copied)
    before = {path: path.read_bytes() for path in every}
    every[0].unlink()
    every[1].write_bytes(before[every[1]][:-30])
    every[2].write_bytes(b"")
    # a decoder takes it; only the checksum tells, by which opening the data set would refuse it
    damaged = bytearray(before[every[3]])
    damaged[damaged.rindex(b"IEND") - 5] ^= 0xFF
    every[3].write_bytes(bytes(damaged))
    with Image.open(every[3]) as picture:
        picture.load()
    Image.new("RGBA", (32, 48)).save(every[4])
    shutil.copy(every[6], every[5])
    half = every[0].with_name(".image0.0badcafe.png")
    half.write_bytes(b"what a killed worker left")
    assert capture(copied) == 0
    assert not half.exists()
    out = capsys.readouterr().out
    assert "5 are broken or of another plan" in out
    assert "6 pictures" in out
    assert {path: path.read_bytes() for path in every} == before


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.suffix != ".lock"
    }


def test_shards_in_any_order_make_the_same_capture(tmp_path, made):
    for shard in ("3/3", "1/3", "2/3"):
        assert capture(tmp_path / "sharded", "--shard", shard) == 0
    assert contents(tmp_path / "sharded") == contents(made)


def test_two_blenders_do_not_make_one_capture(copied, monkeypatch, capsys):
    """Their Cycles draw, and their denoisers smooth, in another way."""
    before = contents(copied)
    assert json.loads(before["plan/made_by.json"]) == {"Blender": "5.0.1", "JGHand": __version__}
    first = pictures(copied)[0]
    first.unlink()
    monkeypatch.setenv("JGHAND_STAND_IN_BLENDER", "5.2.3")
    assert capture(copied) == 2
    error = " ".join(capsys.readouterr().err.split())
    assert "wanted 5.2.3, which is here, got 5.0.1" in error
    assert "--blender-python" in error
    assert not first.exists()
    monkeypatch.delenv("JGHAND_STAND_IN_BLENDER")
    assert capture(copied) == 0
    assert contents(copied) == before


def test_an_unfinished_capture_can_be_used_and_finished_later(tmp_path, monkeypatch, capsys, made):
    folder = tmp_path / "unfinished"
    monkeypatch.setenv("JGHAND_STAND_IN_FAILS_AT", "17")
    assert capture(folder) == 3
    assert capture(folder, "--finished-only") == 0
    assert "2 of 6 poses" in capsys.readouterr().out
    assert len(open_capture(folder).samples) == 14
    monkeypatch.delenv("JGHAND_STAND_IN_FAILS_AT")
    assert capture(folder) == 0
    assert contents(folder) == contents(made)


def test_finished_only_begins_no_capture_in_a_mistyped_folder(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    for folder, came in ((tmp_path / "mistyped", "no such folder"), (tmp_path / "empty", "a folder without a plan")):
        assert capture(folder, "--finished-only") == 2
        error = capsys.readouterr().err
        assert f"--out {folder}" in error
        assert came in error
    assert [path.name for path in tmp_path.rglob("*")] == ["empty"]


def test_a_killed_capture_loses_at_most_the_picture_that_it_was_at(tmp_path, made):
    folder = tmp_path / "killed"
    program = (
        "import sys\nfrom pathlib import Path\nfrom jghand_engine.captures.making import person_skin, worker\n"
        "from jghand_engine.cli import main\n"
        f"worker.find_program, person_skin.MAP_PX = lambda: Path({str(STAND_IN)!r}), {MAP_PX}\nsys.exit(main())\n"
    )
    command = [sys.executable, "-c", program, *WORDS, "--out", str(folder), "--blender-python", sys.executable]
    environment = {**os.environ, "JGHAND_STAND_IN_TAKES_S": "0.05", "OMP_NUM_THREADS": "1"}
    process = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wait_until(lambda: len(pictures(folder)) >= 5 or process.poll() is not None, "five pictures")
    process.send_signal(signal.SIGKILL)
    process.wait()
    there = len(pictures(folder))
    assert 5 <= there < 42
    assert capture(folder) == 0
    assert contents(folder) == contents(made)


def test_other_options_than_those_that_a_capture_was_begun_with_are_named(tmp_path):
    begun = CaptureOptions("3", cameras=4, close_ups=0, poses=2, width=32, height=48, sampling=COARSE)
    open_or_make(tmp_path, begun)
    other = dataclasses.replace(begun, identity="4", cameras=5, light=Light(hdri_strength=0.1))
    told = "got another identity, cameras, light"
    with pytest.raises(InputError, match=told):
        open_or_make(tmp_path, other)
    assert open_or_make(tmp_path, dataclasses.replace(begun, identity="adult_man")).description["cameras"] == 4


def test_the_users_environment_goes_into_the_capture(tmp_path, capsys):
    """It then goes on where that file is not, or lies elsewhere."""
    file = tmp_path / "Sky.HDR"
    file.write_bytes(b"light")
    folder, words = tmp_path / "capture", ("--poses", "1", "--cameras", "1", "--close-ups", "0")
    assert capture(folder, *words, "--lights", str(file)) == 0
    assert (folder / "plan" / "light.hdr").read_bytes() == b"light"
    assert str(tmp_path) not in (folder / "plan" / "plan.json").read_text(encoding="utf-8")
    moved = tmp_path / "moved"
    folder.rename(moved)
    file.unlink()
    capsys.readouterr()
    assert capture(moved, *words, "--lights", str(moved / "plan" / "light.hdr")) == 0
    assert "0 pictures" in capsys.readouterr().out
    (moved / "plan" / "light.hdr").unlink()
    with pytest.raises(InputError, match=r"light\.hdr"):
        read_plan(moved)


@pytest.mark.parametrize("damage", ["plan.json", "hands.npz", "skin.png"])
def test_a_damaged_plan_is_told_and_not_replaced(copied, damage, capsys):
    """What pictures belong to it can no longer be said."""
    file = copied / "plan" / damage
    if damage == "skin.png":
        file.unlink()
    else:
        file.write_bytes(file.read_bytes()[:-40])
    assert capture(copied) == 2
    assert "the plan of the capture" in capsys.readouterr().err


def test_poses_can_come_from_a_motion():
    plan = plan_of_motion(Handedness.RIGHT)
    assert plan.pose_names == ("frame_0", "frame_5", "frame_9", "frame_14")
    mirrored = plan_of_motion(Handedness.LEFT)
    # a left hand's motion is played by the right hand
    np.testing.assert_allclose(mirrored.joints_m, plan.joints_m, atol=1e-12)
    assert plan.forearm is not None
    assert plan.forearm.shape == (4, 4)


def plan_of_motion(handedness: Handedness) -> CapturePlan:
    whole = pose_sequence_of_names(["open", "fist"], load_template().joints_m, handedness=handedness)
    motion = PoseSequence(whole.joints_m[8:23], 30.0, handedness)
    return make_plan(
        CaptureOptions("3", cameras=2, close_ups=0, poses=4, width=32, height=48, motion=motion, sampling=COARSE)
    )


@pytest.mark.parametrize(
    ("words", "named"),
    [
        (["--shard", "3/2"], "--shard"),
        (["--samples", "0"], "samples"),
        (["--cameras", "0"], "cameras"),
        (["--lights", "moonbase"], "light"),
        (["--person", "absent.json"], "absent.json"),
        (["--seed", "-1"], "seed"),
    ],
)
def test_bad_options_are_refused_by_name_and_write_nothing(tmp_path, words, named, capsys):
    assert capture(tmp_path / "bad", *words) == 2
    assert named in capsys.readouterr().err
    assert not pictures(tmp_path / "bad")


def test_a_python_that_is_not_there_is_refused(tmp_path, capsys):
    assert main([*WORDS, "--out", str(tmp_path / "none"), "--blender-python", str(tmp_path / "python")]) == 2
    assert "--blender-python" in capsys.readouterr().err


def test_without_any_blender_the_remedy_is_told(monkeypatch, tmp_path):
    monkeypatch.setattr(worker, "PROJECT", tmp_path)
    monkeypatch.setattr(worker.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="--blender-python"):
        worker.find_blender_python()


def test_the_real_worker_says_when_its_python_has_no_bpy(tmp_path, monkeypatch, made):
    """The engine's own Python has none; where it has, there is nothing to show."""
    if worker.importlib.util.find_spec("bpy"):
        pytest.skip("this Python has bpy")
    monkeypatch.setattr(worker, "find_program", FIND_PROGRAM)
    plan = read_plan(made)
    assert plan is not None
    with pytest.raises(InputError, match="bpy"):
        list(worker.render(made, plan.jobs(tmp_path), Path(sys.executable), threads=1))


def test_the_program_is_found_in_a_checkout_and_where_the_extension_says_it_is(tmp_path, monkeypatch):
    monkeypatch.delenv(worker.ADDON_VARIABLE, raising=False)
    assert FIND_PROGRAM() == ROOT / "blender_addon" / "capture" / "__main__.py"
    monkeypatch.setenv(worker.ADDON_VARIABLE, str(tmp_path))
    with pytest.raises(InputError, match="Blender extension"):
        FIND_PROGRAM()
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "__main__.py").touch()
    assert FIND_PROGRAM() == tmp_path / "capture" / "__main__.py"


def test_a_program_that_is_no_worker_is_told_with_its_last_words(tmp_path, monkeypatch, made):
    program = tmp_path / "program.py"
    program.write_text("import sys; print('hello'); sys.exit('no worker at all')", encoding="utf-8")
    monkeypatch.setattr(worker, "find_program", lambda: program)
    plan = read_plan(made)
    assert plan is not None
    with pytest.raises(RetryError, match="no worker at all"):
        list(worker.render(made, plan.jobs(tmp_path), Path(sys.executable), threads=1))


def test_the_seed_of_a_capture_leaves_the_skin_alone(tmp_path):
    words = [*WORDS, "--poses", "2", "--subdivisions", "1", "--blender-python", sys.executable]
    assert main([*words, "--seed", "77", "--out", str(tmp_path)]) == 0
    plan = read_plan(tmp_path)
    assert plan is not None
    assert plan.render["skin"]["person"] == dataclasses.asdict(Person())


def test_a_person_gives_a_capture_its_skin_and_another_person_is_another_capture(tmp_path, monkeypatch, capsys):
    (tmp_path / "ann.json").write_text(json.dumps({"melanin": 0.9, "seed": 4}))
    words = [*WORDS, "--poses", "2", "--subdivisions", "1", "--blender-python", sys.executable]
    one = [*words, "--person", str(tmp_path / "ann.json"), "--out", str(tmp_path / "ann")]
    assert main(one) == 0
    plan = read_plan(tmp_path / "ann")
    assert plan is not None
    assert plan.render["skin"]["person"] == dataclasses.asdict(Person(melanin=0.9, seed=4))
    # ... of few texels, as was asked for above
    with Image.open(tmp_path / "ann" / "plan" / "skin.png") as painted:
        assert painted.size == (128, 128)
    # Loop's surface, whose vertices the worker takes as they are; the engine keeps the rig's
    mesh = np.load(tmp_path / "ann" / "plan" / person_skin.MESH_FILE, mmap_mode="r")
    assert mesh.shape == (2, 6994, 4)
    # 1609 of the hand, 141 of its forearm
    assert plan.vertices_m.shape == (2, 1750, 3)
    np.testing.assert_allclose(mesh[..., :3].mean(1), plan.vertices_m.mean(1), atol=5e-3)
    assert 0 <= mesh[..., 3].min() < mesh[..., 3].max() <= 1
    assert plan.render["sampling"]["subdivisions"] == 0
    before = contents(tmp_path / "ann")
    pictures(tmp_path / "ann")[0].unlink()
    assert main(one) == 0
    assert contents(tmp_path / "ann") == before
    assert main([*words, "--person", "7", "--out", str(tmp_path / "ann")]) == 2
    assert "another skin" in " ".join(capsys.readouterr().err.split())
    assert main([*words, "--person", str(tmp_path / "none.json"), "--out", str(tmp_path / "other")]) == 2
    assert "none.json" in capsys.readouterr().err
    file = tmp_path / "ann" / "plan" / person_skin.MESH_FILE
    file.write_bytes(file.read_bytes()[:-40])
    assert main(one) == 2
    assert "the plan of the capture" in capsys.readouterr().err


def test_hair_is_in_the_plan_and_in_the_stamps_of_its_pictures(tmp_path):
    one = CaptureOptions("3", cameras=1, close_ups=0, poses=2, width=32, height=48, sampling=COARSE)
    hairy = dataclasses.replace(one, skin=Person(hair=0.5))
    made, bare = open_or_make(tmp_path / "hairy", hairy), open_or_make(tmp_path / "bare", one)
    opened = open_or_make(tmp_path / "hairy", hairy)
    assert [opened.stamp(pose, 0) for pose in (0, 1)] == [made.stamp(pose, 0) for pose in (0, 1)]
    assert opened.stamp(0, 0) != bare.stamp(0, 0)
    # all else of their skin is the same to the bit
    assert {name: made.files[name] for name in bare.files} == bare.files
    assert set(made.files) - set(bare.files) == {person_skin.HAIR_FILE}
    strands = np.load(tmp_path / "hairy" / "plan" / person_skin.HAIR_FILE)
    assert strands[..., 0].max() < len(made.faces)
    (tmp_path / "hairy" / "plan" / person_skin.HAIR_FILE).unlink()
    with pytest.raises(InputError, match=r"hair\.npy"):
        read_plan(tmp_path / "hairy")


def test_a_capture_that_was_begun_before_persons_had_hair_goes_on(copied):
    file = copied / "plan" / "plan.json"
    content = json.loads(file.read_text(encoding="utf-8"))
    del content["options"]["skin"]["hair"]
    file.write_text(json.dumps(content), encoding="utf-8")
    assert capture(copied, "--finished-only") == 0


PERSON_OPTIONS = CaptureOptions(
    "3", cameras=1, close_ups=0, poses=2, width=32, height=48, sampling=Sampling(subdivisions=1)
)


@pytest.fixture(scope="module")
def person_plan() -> CapturePlan:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(person_skin, "MAP_PX", MAP_PX)
        return make_plan(PERSON_OPTIONS)


def test_images_and_boxes_are_those_of_the_hand_whatever_its_forearm_does(person_plan):
    (camera,), box = person_plan.record.cameras.values(), person_plan.record.boxes_px[0, "400000"]
    hand, forearm = np.split(person_plan.vertices_m[0].astype(float), [1609])
    seen, behind = camera.project(hand)[0], camera.project(forearm)[0]
    np.testing.assert_allclose([*seen.min(0), *(seen.max(0) - seen.min(0))], box, atol=1e-3)
    size = np.array([camera.width, camera.height])
    assert (seen >= 0).all()
    assert (seen <= size).all()
    # the forearm runs out of the image
    assert ((behind < 0) | (behind > size)).any()
