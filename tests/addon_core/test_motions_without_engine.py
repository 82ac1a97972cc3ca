"""Motions come from files that say what they hold; damaged, silent and hostile files are refused with a sentence."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from blender_addon.core import limits, posing
from blender_addon.core.joints import FINGERS, NAMES
from blender_addon.errors import JGHandFailure
from blender_addon.hand import motion_files

SAID = {"order": "standard", "unit": "m", "fps": 25.0, "handedness": "left"}


def motion_m(frames: int = 4) -> np.ndarray:
    return posing.rest_joints_m("left") + 0.01 * np.arange(frames)[:, None, None]


def write_npz(path: Path, joints: np.ndarray, **said: object) -> Path:
    content = {**SAID, **said}
    np.savez(path, joints_m=joints, **{name: np.array(value) for name, value in content.items() if value is not None})
    return path


def write_json(path: Path, joints: list, **said: object) -> Path:
    path.write_text(json.dumps({"format": "jghand motion", "version": 1, **SAID, **said, "joints": joints}))
    return path


def write_csv(path: Path, joints: np.ndarray) -> Path:
    header = ",".join(["frame", *(f"{name}_{axis}" for name in NAMES for axis in "xyz")])
    rows = [",".join([str(at), *(repr(float(x)) for x in frame.ravel())]) for at, frame in enumerate(joints)]
    path.write_text("\n".join([*(f"# {name}: {value}" for name, value in SAID.items()), header, *rows]))
    return path


@pytest.mark.parametrize("suffix", ["npz", "json", "csv"])
def test_a_motion_is_read_from_every_format(tmp_path, suffix):
    path, joints = tmp_path / f"motion.{suffix}", motion_m()
    {"npz": write_npz, "csv": write_csv, "json": lambda p, j: write_json(p, j.tolist())}[suffix](path, joints)
    motion = motion_files.read_motion(path)
    np.testing.assert_array_equal(motion.joints_m, joints)
    assert (motion.fps, motion.handedness, motion.notes) == (25.0, "left", ())


def test_level_order_and_millimeters_are_turned_into_ours(tmp_path):
    names = ["wrist", *(f"{finger}{level}" for level in (1, 2, 3, 4) for finger in FINGERS)]
    joints = 1000 * motion_m()[:, [NAMES.index(name) for name in names]]
    motion = motion_files.read_motion(write_json(tmp_path / "a.json", joints.tolist(), order="level", unit="mm"))
    np.testing.assert_allclose(motion.joints_m, motion_m(), atol=1e-15)


def test_frames_that_miss_a_joint_hold_the_last_whole_pose_and_that_is_said(tmp_path):
    joints = motion_m(5)
    lists = joints.tolist()
    lists[0][3], lists[3][7] = None, [0.0, None, 0.0]
    valid = np.ones((5, 21), bool)
    valid[0, 3] = valid[3, 7] = False
    files = (write_json(tmp_path / "a.json", lists), write_npz(tmp_path / "a.npz", joints, valid=valid))
    for path in files:
        motion = motion_files.read_motion(path)
        np.testing.assert_array_equal(motion.joints_m, joints[[1, 1, 2, 2, 4]])
        assert motion.notes == ("2 of 5 frames miss joints; they hold the last whole pose.",)


def test_frames_that_were_filled_in_are_known(tmp_path):
    joints = motion_m(5)
    path = write_csv(tmp_path / "a.csv", joints)
    path.write_text("# filled: 1 4\n" + path.read_text())
    flags = np.array([False, True, False, False, True])
    files = (
        path,
        write_json(tmp_path / "a.json", joints.tolist(), filled=[1, 4]),
        write_npz(tmp_path / "a.npz", joints, filled=flags),
    )
    for file in files:
        np.testing.assert_array_equal(motion_files.read_motion(file).filled, flags)
    gone = joints.tolist()
    gone[2][7] = None
    held = motion_files.read_motion(write_json(tmp_path / "b.json", gone, filled=[4]))
    assert np.flatnonzero(held.filled).tolist() == [2, 4], "what was held was not measured either"
    assert motion_files.read_motion(write_npz(tmp_path / "c.npz", joints)).filled is None


def test_what_was_filled_in_stays_known_in_a_written_file(tmp_path):
    flags = np.array([False, True, False, False, True])
    for filled in (flags, None):
        motion_files.write_motion(tmp_path / "a.npz", motion_files.MotionFile(motion_m(5), 30.0, "left", (), filled))
        np.testing.assert_array_equal(motion_files.read_motion(tmp_path / "a.npz").filled, filled)


@pytest.mark.parametrize(
    "filled",
    [[5], [-1], ["x"], 3, 0, [float("inf")], {"a": 1}, [True, False, True, False, False], [1.7], [1.0], False],
)
def test_frames_that_are_not_there_cannot_be_filled_in(tmp_path, filled):
    with pytest.raises(JGHandFailure, match="'filled' wants frames from 0 to 4"):
        motion_files.read_motion(write_json(tmp_path / "a.json", motion_m(5).tolist(), filled=filled))


@pytest.mark.parametrize("filled", [np.zeros(4, bool), np.zeros((5, 2), bool), np.array(list("abcde"))])
def test_flags_of_other_frames_are_refused(tmp_path, filled):
    with pytest.raises(JGHandFailure, match="'filled' wants frames from 0 to 4"):
        motion_files.read_motion(write_npz(tmp_path / "a.npz", motion_m(5), filled=filled))


@pytest.mark.parametrize("name", SAID)
def test_what_a_file_does_not_say_is_asked_for(tmp_path, name):
    path = write_json(tmp_path / "a.json", motion_m().tolist(), **{name: None})
    with pytest.raises(JGHandFailure, match=f"does not say its {name}") as caught:
        motion_files.read_motion(path)
    assert caught.value.kind == "bad_motion"


@pytest.mark.parametrize(
    ("said", "word"),
    [
        ({"order": "mano"}, "order"),
        ({"unit": "inch"}, "unit"),
        ({"handedness": "both"}, "handedness"),
        ({"fps": 0}, "fps"),
        ({"fps": "fast"}, "fps"),
        ({"fps": float("nan")}, "fps"),
        ({"version": 2}, "version"),
        ({"format": "other"}, "other"),
        ({"joints": [[[0, 0, 0]] * 20]}, "21 joints"),
        ({"joints": []}, "21 joints"),
        ({"joints": [[None] * 21]}, "no frame"),
        ({"joints": [[["a", "b", "c"]] * 21]}, "numbers"),
        ({"joints": 3}, "json"),
    ],
)
def test_what_makes_no_motion_is_refused(tmp_path, said, word):
    path = tmp_path / "a.json"
    path.write_text(
        json.dumps({"format": "jghand motion", "version": 1, **SAID, "joints": motion_m().tolist(), **said})
    )
    with pytest.raises(JGHandFailure, match=word) as caught:
        motion_files.read_motion(path)
    assert caught.value.kind == "bad_motion"


def hostile_npz(header: dict) -> bytes:
    """An archive with an array whose header says whatever it likes."""
    text = repr(header).encode()
    text += b" " * (63 - (10 + len(text)) % 64) + b"\n"
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("joints_m.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text)
    return stream.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"PK\x03\x04 no archive",
        hostile_npz({"descr": "<f8", "fortran_order": False, "shape": (10**9, 21, 3)}),
        hostile_npz({"descr": "|O", "fortran_order": False, "shape": (1,)}),
        hostile_npz({"descr": "<f8"}),
    ],
    ids=["empty", "no archive", "larger than it is", "objects", "no shape"],
)
def test_damaged_and_hostile_archives_are_refused(tmp_path, content):
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(JGHandFailure) as caught:
        motion_files.read_motion(path)
    assert caught.value.kind == "bad_motion"


def test_absent_unknown_and_too_large_files_are_refused(tmp_path, monkeypatch):
    for name in ("absent.npz", "motion.npy", "motion"):
        with pytest.raises(JGHandFailure) as caught:
            motion_files.read_motion(tmp_path / name)
        assert caught.value.kind == "bad_motion"
    path = write_npz(tmp_path / "a.npz", motion_m())
    monkeypatch.setattr(limits, "MOTION_MAX_BYTES", 100)
    with pytest.raises(JGHandFailure, match="more than a motion"):
        motion_files.read_motion(path)


def test_a_table_without_the_columns_names_those_it_wants(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("# unit: m\nframe,wrist_x\n0,1\n")
    with pytest.raises(JGHandFailure, match="wrist_y, wrist_z, thumb1_x …"):
        motion_files.read_motion(path)
