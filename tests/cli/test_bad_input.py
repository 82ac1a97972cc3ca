"""Bad input and a world that is not ready: a clear sentence, the right exit code, nothing half-written."""

import errno
import json
import os
import shlex
import subprocess
import sys

import numpy as np
import pytest

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.cli import main
from jghand_engine.export.pictures import read_png
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names

SMALL = ("--size", "32x24", "--preset", "draft")


@pytest.fixture(scope="module")
def joints():
    """(F, 21, 3) a good motion, standard order, meters."""
    canonical = load_painted(handedness=Handedness.RIGHT).canonical_joints_m
    motion = pose_sequence_of_names(
        ["open", "fist"], canonical, handedness=Handedness.RIGHT, options=MotionOptions(hold_s=0.0)
    )
    return from_level(motion.joints_m, JointOrder.STANDARD)[2:14]


@pytest.fixture
def command(tmp_path, capsys):
    """Runs a command; returns its exit code and the one line it said on standard error."""

    def run(*words):
        code = main([str(word) for word in words])
        err = capsys.readouterr().err
        assert "Traceback" not in err
        assert len(err.strip().splitlines()) == (1 if code else 0), err
        return code, err.strip()

    return run


@pytest.fixture
def refused(tmp_path, command):
    """Runs a command that is refused in these words, and makes no folder `out`."""

    def run(*words, says):
        was_there = (tmp_path / "out").exists()
        code, err = command(*words)
        assert code == 2
        for each in [says] if isinstance(says, str) else says:
            assert each in err
        assert (tmp_path / "out").exists() == was_there

    return run


def of_motion(folder, array, *more, order="standard"):
    """The words that render an array as a motion file into `out`."""
    np.save(folder / "motion.npy", array)
    words = ("render", "--motion", folder / "motion.npy", "--hand", "right", "--order", order)
    return *words, "--out", folder / "out", *SMALL, *more


def gappy(joints):
    """Two of its frames lack a joint."""
    joints = joints.copy()
    joints[4:6, 9] = np.nan
    return joints


def test_joints_that_are_missing_are_held_and_counted(joints, command, tmp_path):
    assert command(*of_motion(tmp_path, gappy(joints), "--frames", "0:7", "--on-missing", "hold"))[0] == 0
    assert len(list((tmp_path / "out").glob("frame_*.png"))) == 8
    pictures = [read_png(tmp_path / f"out/frame_{index:05d}.png").tobytes() for index in range(8)]
    assert pictures[3] == pictures[4] == pictures[5], "the last whole pose"
    assert pictures[6] != pictures[5]


def test_joints_that_are_missing_are_filled_unless_asked_otherwise(joints, command, tmp_path):
    assert command(*of_motion(tmp_path, gappy(joints), "--frames", "0:7"))[0] == 0
    pictures = [read_png(tmp_path / f"out/frame_{index:05d}.png").tobytes() for index in range(3, 7)]
    assert len(set(pictures)) == 4, "the hand moves on through the gap"


def test_joints_that_are_missing_stop_the_command_when_asked_for(joints, refused, tmp_path):
    refused(*of_motion(tmp_path, gappy(joints), "--on-missing", "stop"), says="2 of 12 frames")


def test_a_unit_that_nobody_said_is_recognized_and_told(joints, command, tmp_path):
    figures = tmp_path / "figures.json"
    assert command(*of_motion(tmp_path, joints * 1000, "--frames", "0", "--json", figures))[0] == 0
    assert "millimeters; --unit sets another" in json.loads(figures.read_text())["notes"][0]


def test_a_motion_that_cannot_be_shown_is_refused(joints, refused, tmp_path):
    refused(*of_motion(tmp_path, joints, order="interhand"), says="order 'standard'")
    refused(*of_motion(tmp_path, np.zeros((0, 21, 3))), says="empty")
    no_whole_frame = np.where(np.arange(21)[:, None] == 3, np.nan, joints)
    refused(*of_motion(tmp_path, no_whole_frame), says="at least one frame")
    refused(*of_motion(tmp_path, joints, "--frames", "50:60"), says="12 frames")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ((), ""),
        (("--poses", "open", "--motion", "x.npz"), ""),
        (("--poses", "open,wave"), "fist"),
        (("--poses", "open", "--avatar", "no.jghand"), "no.jghand"),
        *((("--poses", "open", *SMALL, *words), "") for words in (
            ("--size", "0x4"), ("--background", "pink"), ("--camera", "absent.json"), ("--camera", "above"),
        )),
    ],
)  # fmt: skip
def test_wrong_words_are_refused_before_anything_is_written(tmp_path, refused, words, says):
    refused("render", "--out", tmp_path / "out", *words, says=says)


@pytest.mark.parametrize("verb", ["render", "export"])
def test_a_file_in_the_way_of_the_folder_is_named(tmp_path, refused, verb):
    (tmp_path / "out").write_text("mine")
    more = SMALL if verb == "render" else ()
    refused(verb, "--poses", "open", "--frames", "0", "--out", tmp_path / "out", *more, says="in the way")
    assert (tmp_path / "out").read_text() == "mine"


def test_a_folder_that_the_system_refuses_is_named(tmp_path, refused, monkeypatch):
    """The same for root, who may write everywhere: the refusal is simulated."""

    def refuse(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    out = tmp_path / "out"
    refused("render", "--poses", "open", "--frames", "0", "--out", out, *SMALL, says="permission denied")


def test_pictures_of_a_longer_render_are_neither_mixed_in_nor_removed(tmp_path, command):
    out = tmp_path / "out"
    words = ("render", "--poses", "open,fist", "--out", out, *SMALL)
    assert command(*words, "--frames", "0:3")[0] == 0
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    code, err = command(*words, "--frames", "0:1", "--camera", "back")
    assert code == 2
    assert "frame_00002.png to frame_00003.png" in err
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert command(*words, "--frames", "0:3", "--camera", "back")[0] == 0, "as many are simply replaced"
    assert command(*words, "--frames", "0:4")[0] == 0


def test_a_full_disk_leaves_nothing_half_written(tmp_path, command, monkeypatch):
    real = os.fsync
    written = []

    def full(handle):
        written.append(handle)
        if len(written) > 3:
            raise OSError(errno.ENOSPC, "No space left on device")
        real(handle)

    monkeypatch.setattr("jghand_engine.files.os.fsync", full)
    out = tmp_path / "out"
    code, err = command("render", "--poses", "open,fist", "--out", out, *SMALL)
    assert code == 3
    assert "disk is full" in err
    assert sorted(path.name for path in out.iterdir()) == ["camera.json", "frame_00000.png", "made_from.json"], (
        "whole files only"
    )


def test_a_traceback_is_shown_when_asked_for(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("JGHAND_DEBUG", "1")
    assert main(["render", "--poses", "wave", "--out", str(tmp_path)]) == 2
    assert "Traceback" in capsys.readouterr().err


def test_a_reader_that_has_seen_enough_ends_a_command_quietly():
    shell = f"{shlex.quote(sys.executable)} -m jghand_engine render --help | head -c 10"
    done = subprocess.run(["bash", "-c", shell], capture_output=True, text=True, check=False, timeout=120)
    assert not done.stderr
