"""`jghand motion`, and motions of other programs in the commands that take one."""

import json

import motion_samples as samples
import numpy as np
import pytest
from command_line import run

from jghand_engine.hand.joints import LEVEL_NAMES, Handedness
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.motion.read import read_motion_file


@pytest.fixture
def bvh(tmp_path):
    path = tmp_path / "dance.bvh"
    samples.write_bvh(path, samples.rig(samples.motion(), scale=100))
    return path


def test_a_motion_of_another_program_becomes_one_of_ours(bvh, tmp_path, capsys):
    figures = tmp_path / "figures.json"
    assert run("motion", bvh, "--out", tmp_path / "out.npz", "--json", figures) == 0
    said = capsys.readouterr().out
    assert "centimeters; --unit sets another" in said
    assert "right hand of 195 mm, 40 frames at 30 fps" in said
    motion = samples.motion()
    assert np.abs(read_motion_file(tmp_path / "out.npz").sequence.joints_m - motion.joints_m).max() < 5e-8
    content = json.loads(figures.read_text())
    assert (content["format"], content["hand"], content["frames"], content["filled_frames"]) == ("BVH", "right", 40, 0)


def test_it_is_cut_taken_at_another_rate_and_mirrored(bvh, tmp_path):
    words = ("--start", "0.2", "--end", "1.0", "--to-fps", "60", "--mirror", "--in-place", "--hand-length", "180")
    assert run("motion", bvh, "--out", tmp_path / "out.npz", *words) == 0
    read, whole = read_motion_file(tmp_path / "out.npz").sequence, samples.motion()
    assert (len(read), read.fps, read.handedness) == (49, 60.0, Handedness.LEFT)
    assert np.ptp(read.joints_m[:, 0], axis=0).max() < 1e-15
    bones, wanted = (one - one[:, :1] for one in (read.joints_m[::2], whole.joints_m[6:31]))
    scale = np.median(np.linalg.norm(bones[:, 1], axis=-1) / np.linalg.norm(wanted[:, 1], axis=-1))
    assert np.abs(bones * [-1, 1, 1] - scale * wanted).max() < 1e-7
    assert np.ptp(bone_lengths(read.joints_m), axis=0).max() < 1e-7


def test_bones_of_no_convention_are_named_in_a_map(tmp_path, capsys):
    names = tuple(f"knochen {place}" if name else None for place, name in enumerate(samples.MIXAMO))
    rig = samples.rig(samples.motion(), names, 100)
    samples.write_bvh(tmp_path / "a.bvh", rig)
    assert run("motion", tmp_path / "a.bvh", "--hand", "right", "--out", tmp_path / "a.npz") == 2
    assert "--bones" in capsys.readouterr().err
    bones = {joint: f"knochen_{place}" for place, joint in enumerate(LEVEL_NAMES) if not joint.endswith("4")}
    words = ("motion", tmp_path / "a.bvh", "--out", tmp_path / "a.npz", "--bones", tmp_path / "map.json")
    (tmp_path / "map.json").write_text(json.dumps(bones))
    assert run(*words, "--hand", "right") == 0
    assert np.abs(read_motion_file(tmp_path / "a.npz").sequence.joints_m - samples.motion().joints_m).max() < 5e-8
    joints = {**{joint: [bone, "head"] for joint, bone in bones.items()}, "index4": [bones["index3"], "tail"]}
    (tmp_path / "map.json").write_text(json.dumps({"handedness": "right", "joints": joints}))
    assert run(*words, "--overwrite") == 0
    for broken, said in (({**bones, "thumb2": "other"}, "other (thumb2)"), ({"elbow": "x"}, "wrist"), ([], "wrist")):
        (tmp_path / "map.json").write_text(json.dumps(broken))
        assert run(*words, "--overwrite", "--hand", "right") == 2
        assert said in capsys.readouterr().err


@pytest.mark.parametrize(("how", "filled", "missing"), [("fill", 3, 0), ("hold", 3, 0), ("keep", 0, 3)])
def test_what_is_missing_is_filled_held_or_kept(tmp_path, how, filled, missing):
    joints = samples.standard(samples.motion()).copy()
    joints[4:7, 6] = np.nan
    np.save(tmp_path / "a.npy", joints)
    assert run("motion", tmp_path / "a.npy", "--hand", "right", "--out", tmp_path / "a.npz", "--on-missing", how) == 0
    read = read_motion_file(tmp_path / "a.npz").sequence
    assert (int(read.filled.sum()), len(read.gaps.frames)) == (filled, missing)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--out", "out.bvh"), ".npz, .json, .csv"),
        (("--out", "out.npz", "--to-fps", "0"), "--to-fps"),
        (("--out", "out.npz", "--to-fps", "nan"), "--to-fps"),
        (("--out", "out.npz", "--start", "9"), "cut"),
        (("--out", "out.npz", "--hand-length", "2"), "length of the hand"),
        (("--out", "out.npz", "--hand", "left"), "--mirror"),
        (("--out", "dance.bvh.npz"), "--overwrite"),
    ],
)
def test_what_cannot_be_done_is_said(bvh, tmp_path, monkeypatch, capsys, words, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "dance.bvh.npz").write_text("mine")
    assert run("motion", bvh, *words) == 2
    assert said in capsys.readouterr().err
    assert (tmp_path / "dance.bvh.npz").read_text() == "mine"
    assert not (tmp_path / "out.npz").exists()


def test_render_and_info_take_a_folder_of_frames(tmp_path, capsys):
    samples.write_openpose(tmp_path / "op", samples.standard(samples.motion(frames=3)) * 1000)
    words = ("--frames", "0", "--size", "64x48", "--preset", "draft", "--avatar", "painted")
    assert run("render", "--motion", tmp_path / "op", "--out", tmp_path / "out", *words) == 0
    capsys.readouterr()
    assert run("info", tmp_path / "op") == 0
    assert "OpenPose" in capsys.readouterr().out


def test_render_and_info_take_the_file_itself(bvh, tmp_path, capsys):
    words = ("--frames", "0", "--size", "64x48", "--preset", "draft", "--avatar", "painted")
    assert run("render", "--motion", bvh, "--out", tmp_path / "out", *words) == 0
    assert (tmp_path / "out" / "frame_00000.png").exists()
    capsys.readouterr()
    assert run("info", bvh) == 0
    said = capsys.readouterr().out
    assert "BVH" in said
    assert "195" in said


def test_a_motion_without_one_whole_middle_finger_is_written_all_the_same(tmp_path, capsys):
    joints = samples.standard(samples.motion()).copy()
    joints[:, 12] = np.nan
    np.save(tmp_path / "a.npy", joints)
    words = ("--hand", "right", "--unit", "m", "--order", "standard", "--any-proportions", "--on-missing", "keep")
    figures = tmp_path / "figures.json"
    assert run("motion", tmp_path / "a.npy", "--out", tmp_path / "a.npz", *words, "--json", figures) == 0
    assert "right hand of unknown length" in capsys.readouterr().out
    assert json.loads(figures.read_text())["hand_length_mm"] is None


def test_a_cut_between_frames_has_both_its_ends_at_another_rate(tmp_path):
    motion = samples.motion(fps=5.0)
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(motion, scale=100))
    words = ("--start", "0.3", "--end", "0.9", "--to-fps", "30")
    assert run("motion", tmp_path / "a.bvh", "--out", tmp_path / "a.npz", *words) == 0
    read = read_motion_file(tmp_path / "a.npz").sequence
    assert len(read) == 19
    assert np.abs(read.joints_m[3] - motion.joints_m[2]).max() < 1e-7


def test_the_axis_that_points_up_can_be_said(tmp_path, capsys):
    path = tmp_path / "a.bvh"
    samples.write_bvh(path, samples.rig(samples.motion(), scale=100))
    path.write_text(path.read_text().replace("Hips", "Root"))
    made = {}
    for words in ((), ("--file-up", "z")):
        assert run("motion", path, "--out", tmp_path / "a.npz", "--up", "z", "--overwrite", *words) == 0
        made[words] = read_motion_file(tmp_path / "a.npz").sequence.joints_m
        assert ("y is taken; jghand motion --file-up" in capsys.readouterr().out) is (not words)
    x, y, z = np.moveaxis(samples.motion().joints_m, -1, 0)
    np.testing.assert_allclose(made[()], np.stack([x, -z, y], axis=-1), atol=5e-8)
    np.testing.assert_allclose(made["--file-up", "z"], np.stack([x, y, z], axis=-1), atol=5e-8)
    np.save(tmp_path / "b.npy", samples.standard(samples.motion()))
    assert run("motion", tmp_path / "b.npy", "--hand", "right", "--out", tmp_path / "b.npz", "--up", "z") == 0
    assert "left as it is: --file-up" in capsys.readouterr().out.replace("\n", " ")
