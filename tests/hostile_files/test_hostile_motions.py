"""Damaged and malicious motion files: an InputError that names the file, and nothing is run or allocated."""

import contextlib
import json
import os
import zipfile

import motion_samples as samples
import numpy as np
import pytest
from hand import sampled_hands as hands

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.motion import content
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.files import write_motion
from jghand_engine.motion.read import read_motion_file

TOLD = MotionFormat(JointOrder.STANDARD, "m", Handedness.RIGHT, 30.0)


class Trap:
    """Unpickling this writes a file."""

    def __init__(self, path):
        self.path = str(path)

    def __reduce__(self):
        return (os.mkdir, (self.path,))


def _header(shape, dtype="<f8"):
    """The start of an .npy file that promises `shape`, without the numbers."""
    text = f"{{'descr': '{dtype}', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


def test_pickled_objects_are_never_built(tmp_path):
    trap = np.array([Trap(tmp_path / "sprung")], dtype=object)
    np.save(tmp_path / "motion.npy", trap, allow_pickle=True)
    np.savez(tmp_path / "motion.npz", allow_pickle=True, joints_m=trap)
    np.savez(tmp_path / "order.npz", allow_pickle=True, joints_m=np.zeros((2, 21, 3)), order=trap)
    for name in ("motion.npy", "motion.npz", "order.npz"):
        with pytest.raises(InputError, match=name):
            read_motion_file(tmp_path / name, TOLD)
    assert not (tmp_path / "sprung").exists()


def good(folder, suffix, names=("open",)):
    """A motion, and a file of it."""
    motion = pose_sequence_of_names(names, hands.canonical_np(), handedness=Handedness.RIGHT)
    path = folder / f"motion{suffix}"
    if suffix == ".npy":
        np.save(path, motion.joints_m)
    else:
        write_motion(path, motion)
    return motion, path


@pytest.mark.parametrize("suffix", [".npz", ".json", ".csv", ".npy"])
def test_a_file_cut_anywhere_is_an_input_error_or_a_shorter_motion(tmp_path, suffix):
    motion, path = good(tmp_path, suffix)
    whole = path.read_bytes()
    for part in np.linspace(0, len(whole) - 1, 60).astype(int):
        path.write_bytes(whole[:part])
        try:
            shorter = read_motion_file(path, TOLD if suffix in (".npy", ".csv") else None).sequence
        except InputError:
            continue
        # text without a closing mark cannot tell that lines are lost after the last one
        assert suffix == ".csv"
        assert len(shorter) <= len(motion)


@pytest.mark.parametrize("suffix", [".npz", ".npy"])
def test_flipped_bits_never_crash(tmp_path, suffix):
    _, path = good(tmp_path, suffix)
    for broken in samples.flipped(path.read_bytes(), 300):
        path.write_bytes(broken)
        with contextlib.suppress(InputError):
            read_motion_file(path, TOLD)


@pytest.mark.parametrize("shape", ["(1000000000000, 21, 3)", "(2, 21, 3)", "(-1, 21, 3)", "(2, 21, 3, 10**9)", "7"])
def test_headers_that_promise_too_much_are_refused(tmp_path, shape):
    plain, packed = tmp_path / "motion.npy", tmp_path / "motion.npz"
    plain.write_bytes(_header(shape))
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("joints_m.npy", _header(shape))
    for path, says in ((plain, "undamaged"), (packed, "a whole")):
        with pytest.raises(InputError, match=says):
            read_motion_file(path, TOLD)


@pytest.mark.parametrize("suffix", [".npz", ".npy", ".json", ".csv"])
def test_memory_that_runs_out_is_no_damage(tmp_path, monkeypatch, suffix):
    _, path = good(tmp_path, suffix)

    def too_much(*_, **__):
        raise MemoryError

    for name in ("files", "tables"):
        monkeypatch.setattr(f"jghand_engine.motion.{name}.checked_joints", too_much)
    with pytest.raises(MemoryLimitError, match="shorter motions") as caught:
        read_motion_file(path, TOLD)
    assert caught.value.exit_code == 4


def test_more_frames_than_a_motion_has_are_refused_in_text(tmp_path, monkeypatch):
    monkeypatch.setattr(content, "MOTION_FRAMES_MAX", 5)
    for suffix in (".json", ".csv", ".npz"):
        with pytest.raises(InputError, match="more than 5 frames"):
            read_motion_file(good(tmp_path, suffix, ("open", "fist"))[1])


def test_a_file_larger_than_any_motion_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "motion.csv"
    path.write_bytes(b"1," * 1000)
    monkeypatch.setattr(content, "MOTION_TEXT_MAX_BYTES", 1000)
    with pytest.raises(InputError, match=r"at most.*write it as \.npz"):
        read_motion_file(path, TOLD)
    path = tmp_path / "motion.npy"
    np.save(path, np.zeros((4, 21, 3)))
    monkeypatch.setattr(content, "MOTION_MAX_BYTES", 1000)
    with pytest.raises(InputError, match="at most"):
        read_motion_file(path, TOLD)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "null",
        '"joints"',
        '{"joints": 5}',
        '{"joints": [5]}',
        '{"joints": [[5]]}',
        '{"joints": [[[1, 2]]]}',
        '{"joints": [[["a", "b", "c"]]]}',
        '{"joints": [[[1, 2, 3], [1, 2]]]}',
        '{"joints": [[[1, 2, {}]]]}',
        '{"format": "other", "joints": []}',
        '{"version": "1", "joints": []}',
        "[" * 100_000,
        '{"joints": [[[1e999, 1, 1]]]}',
        json.dumps({"joints": [[[10**400] * 3] * 21]}),
        json.dumps({"joints": [[[1.0] * 3] * 21], "fps": "fast"}),
        json.dumps({"joints": [[[1.0] * 3] * 21], "fps": [1]}),
        json.dumps({"joints": [[[1.0] * 3] * 21], "fps": -5}),
        json.dumps({"joints": [[[1.0] * 3] * 21], "order": {"a": 1}}),
        json.dumps({"joints": [[[True] * 3] * 21]}),
    ],
)
def test_json_that_is_no_motion_is_an_input_error(tmp_path, text):
    path = tmp_path / "motion.json"
    path.write_text(text)
    with pytest.raises(InputError):
        read_motion_file(path, MotionFormat(JointOrder.STANDARD, "m", Handedness.RIGHT))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"a,b,c\n1,2,3\n", b"\x00" * 50, b'"' * 200_000])
def test_csv_that_is_no_motion_is_an_input_error(tmp_path, content):
    path = tmp_path / "motion.csv"
    path.write_bytes(content)
    with pytest.raises(InputError):
        read_motion_file(path, TOLD)


@pytest.mark.parametrize(
    "arrays",
    [
        {"nothing": np.zeros(3)},
        {"joints_m": np.zeros((2, 21, 3)), "valid": np.zeros((2, 7))},
        {"joints_m": np.zeros((2, 21, 3)), "order": np.array(["standard", "level"])},
        {"joints_m": np.array("standard")},
        {"joints_m": np.zeros((2, 21, 3), dtype=complex)},
        {"joints_m": np.zeros((2, 21, 3)), "fps": np.array(np.nan)},
    ],
)
def test_archives_that_are_no_motion_are_an_input_error(tmp_path, arrays):
    path = tmp_path / "motion.npz"
    np.savez(path, **arrays)
    with pytest.raises(InputError):
        read_motion_file(path, MotionFormat(JointOrder.STANDARD, "m", Handedness.RIGHT))
