"""The demo's job by the engine alone. With Blender: tests/blender/test_demo.py."""

import json
import os
from dataclasses import replace

import demo_job
import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.export.pictures import read_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.motion.read import read_motion_file
from jghand_engine.native.library import best_variant

ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")

# a second of motion
QUICK = ("--poses", "point,fist", "--size", "64x64")
# of the built-in hand, which cover it whole
GAUSSIANS = 2000


def run(*words):
    return demo_job.main(demo_job.options_of([str(word) for word in words]))


@pytest.fixture(scope="module", autouse=True)
def few_gaussians():
    """The textures of the skin take most of a short demo's time, and nothing here looks at them."""
    hand = replace(load_builtin(handedness=Handedness.RIGHT).prefix(GAUSSIANS), detail=None)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo_job, "load_avatar_called", lambda _: hand)
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("demo")
    # pictures of an earlier, longer demo, and something of the user's
    (out / "frames/front").mkdir(parents=True)
    (out / "frames/front/0999.png").write_bytes(b"old")
    (out / "frames/front/mine.png").write_bytes(b"mine")
    (out / "hand.blend").write_bytes(b"old")
    assert run(*QUICK, "--out", out) == 0
    return out


def test_everything_that_the_page_names_is_there(folder):
    page = (folder / "README.txt").read_text(encoding="utf-8")
    named = [line.split()[0] for line in page.splitlines()[2:] if line and not line.startswith(" ")]
    assert "hand.mp4" in named
    assert "hand.blend" not in named
    for name in named:
        assert (folder / name).exists(), name


def test_every_frame_is_there_from_both_sides_and_in_the_video(folder):
    motion = read_motion_file(folder / "motion.npz").sequence
    for camera in ("front", "back"):
        pictures = sorted((folder / "frames" / camera).glob("0*.png"))
        assert [path.name for path in pictures] == [f"{index:04d}.png" for index in range(1, len(motion) + 1)]
        first, last = (read_png(pictures[index])[..., 3] for index in (0, -1))
        assert 0.05 < (first > 128).mean() < 0.6
        assert not np.array_equal(first, last)
    assert ffmpeg.count_frames_and_secs(str(folder / "hand.mp4"))[0] == len(motion)


def test_the_users_own_files_are_kept(folder):
    assert (folder / "frames/front/mine.png").read_bytes() == b"mine"


def test_a_blend_file_that_no_demo_wrote_is_kept(folder):
    assert (folder / "hand.previous.blend").read_bytes() == b"old"


def test_the_whole_hand_sways_without_changing_its_bones(folder):
    motion = read_motion_file(folder / "motion.npz").sequence
    assert np.ptp(motion.bone_lengths_m, axis=0).max() < 1e-12
    knuckles = motion.joints_m[:, 2] - motion.joints_m[:, 5]
    turned = np.degrees(np.arctan2(knuckles[:, 2], knuckles[:, 0]))
    assert np.ptp(turned) > 40


def test_the_figures_say_that_blender_was_not_there(folder):
    figures = json.loads((folder / "report.json").read_text())
    assert figures["blender"] is False
    assert figures["backend"] == best_variant()
    assert figures["stages"]["whole frame"]["ran"] == 2 * figures["frames"]
    assert figures["usd"]["frames"] == figures["frames"]


def test_a_file_that_was_changed_since_is_kept_under_a_name_of_its_own(folder):
    (folder / "hand.blend").write_bytes(b"work of a day")
    os.utime(folder / "hand.blend", (2e9, 2e9))
    assert run(*QUICK, "--out", folder) == 0
    assert (folder / "hand.previous.blend").read_bytes() == b"old"
    assert (folder / "hand.previous.2.blend").read_bytes() == b"work of a day"


def test_what_is_wrong_is_told_in_a_sentence(tmp_path, capsys):
    assert run("--poses", "waltz", "--out", tmp_path) == 2
    assert "waltz" in capsys.readouterr().err
