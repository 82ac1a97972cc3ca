"""Motions survive files, and what a file does not say must be said. Damaged files: tests/hostile_files."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hand import sampled_hands as hands

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import STANDARD_NAMES, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, from_level
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.files import write_motion
from jghand_engine.motion.read import read_motion_file

SUFFIXES = (".npz", ".json", ".csv")
ANY_CASE = (*SUFFIXES, ".NPZ", ".Json", ".CSV")
TOLD = MotionFormat(JointOrder.STANDARD, "m", Handedness.RIGHT, 30.0)


def _motion():
    motion = pose_sequence_of_names(["open", "fist"], hands.canonical_np(), handedness=Handedness.RIGHT)
    return replace(motion, forearm=None)  # a table of joints has no place for it


def _with_gaps():
    joints = _motion().joints_m.copy()
    joints[3, 7] = np.nan
    joints[5] = np.nan
    return PoseSequence(joints, 24.0, Handedness.LEFT)


@pytest.mark.parametrize("suffix", ANY_CASE)
@pytest.mark.parametrize("motion", [_motion(), _with_gaps()], ids=["whole", "gaps"])
def test_what_is_written_is_read_back_exactly(tmp_path, suffix, motion):
    path = tmp_path / f"deep/er/motion{suffix}"
    write_motion(path, motion)
    again = read_motion_file(path).sequence
    assert np.array_equal(again.joints_m, motion.joints_m, equal_nan=True)
    assert np.array_equal(again.valid, motion.valid)
    assert (again.fps, again.handedness) == (motion.fps, motion.handedness)


def _with_forearm():
    turns = np.random.default_rng(0).normal(size=(len(_motion()), 4))
    return replace(_motion(), forearm=turns)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_how_a_forearm_is_turned_is_read_back(tmp_path, suffix):
    motion = _with_forearm()
    write_motion(tmp_path / f"motion{suffix}", motion)
    again = read_motion_file(tmp_path / f"motion{suffix}").sequence
    assert again.forearm is not None
    assert motion.forearm is not None
    np.testing.assert_allclose(again.forearm, motion.forearm, atol=1e-15)
    np.testing.assert_array_equal(again.joints_m, motion.joints_m)


@pytest.mark.parametrize("broken", ["forearm_w,", ",,,", ""], ids=["three columns", "no numbers", "no turn"])
def test_a_table_whose_forearm_is_turned_in_no_way_is_refused(tmp_path, broken):
    path = tmp_path / "motion.csv"
    write_motion(path, _with_forearm())
    lines = path.read_text().splitlines()
    if "_" in broken:
        path.write_text("\n".join(line.replace(broken, "other,") for line in lines))
    else:
        path.write_text(
            "\n".join([*lines[:-1], lines[-1].rsplit(",", 4)[0] + (broken + "," if broken else 4 * ",0.0")])
        )
    with pytest.raises(InputError, match="forearm"):
        read_motion_file(path)


def test_turns_of_a_forearm_that_are_none_are_named(tmp_path):
    motion = _motion()
    for turns in (np.ones((len(motion), 3)), np.ones((len(motion) - 1, 4)), np.zeros((len(motion), 4))):
        np.savez(tmp_path / "motion.npz", joints_m=from_level(motion.joints_m, JointOrder.STANDARD), forearm=turns)
        with pytest.raises(InputError, match="forearm"):
            read_motion_file(tmp_path / "motion.npz", TOLD)


@pytest.mark.parametrize("unit", list(METERS_PER_UNIT))
@pytest.mark.parametrize("order", list(JointOrder))
def test_plain_arrays_are_read_in_the_order_and_unit_that_are_told(tmp_path, order, unit):
    motion = _motion()
    path = tmp_path / "motion.npy"
    np.save(path, from_level(motion.joints_m, order) / METERS_PER_UNIT[unit])
    again = read_motion_file(path, MotionFormat(order, unit, Handedness.LEFT, 60.0)).sequence
    assert np.abs(again.joints_m - motion.joints_m).max() < 1e-15
    assert (again.fps, again.handedness) == (60.0, Handedness.LEFT)


def test_the_hand_of_a_plain_array_is_asked_for(tmp_path):
    path = tmp_path / "motion.npy"
    np.save(path, from_level(_motion().joints_m, JointOrder.STANDARD))
    with pytest.raises(InputError, match="Say the hand with --hand"):
        read_motion_file(path, MotionFormat(JointOrder.STANDARD, "m"))


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    ("told", "says"),
    [
        (MotionFormat(order=JointOrder.INTERHAND), "order of .* wanted 'standard'"),
        (MotionFormat(unit="mm"), "unit of .* wanted 'm'"),
        (MotionFormat(handedness=Handedness.LEFT), "wanted a left hand, got a right one only"),
    ],
)
def test_what_the_file_declares_must_not_be_contradicted(tmp_path, suffix, told, says):
    path = tmp_path / f"motion{suffix}"
    write_motion(path, _motion())
    with pytest.raises(InputError, match=says):
        read_motion_file(path, told)


@pytest.mark.parametrize(
    ("shape", "says"),
    [
        ((9, 20, 3), "One joint is missing"),
        ((9, 42, 3), "two hands of InterHand2.6M"),
        ((9, 21, 2), "shape"),
        ((21, 3), "shape"),
    ],
)
def test_what_is_no_hand_is_named(tmp_path, shape, says):
    path = tmp_path / "motion.npy"
    np.save(path, np.ones(shape))
    with pytest.raises(InputError, match=says):
        read_motion_file(path, TOLD)


def test_an_empty_motion_is_named(tmp_path):
    for suffix, write in (
        (".npy", lambda path: np.save(path, np.zeros((0, 21, 3)))),
        (".npz", lambda path: np.savez(path, joints_m=np.zeros((0, 21, 3)))),
        (".json", lambda path: path.write_text('{"joints": []}')),
        (".csv", lambda path: path.write_text("# unit: m\n")),
    ):
        path = tmp_path / f"motion{suffix}"
        write(path)
        with pytest.raises(InputError, match="empty"):
            read_motion_file(path, TOLD)


def test_a_motion_of_nothing_but_gaps_is_named(tmp_path):
    path = tmp_path / "motion.npy"
    np.save(path, np.full((4, 21, 3), np.nan))
    with pytest.raises(InputError, match="hands that are in no frame"):
        read_motion_file(path, TOLD)


def test_json_takes_null_joints_null_coordinates_and_plain_lists(tmp_path):
    frames = from_level(_motion().joints_m, JointOrder.STANDARD)[:3].tolist()
    frames[1][4] = None
    frames[2][5][1] = None
    path = tmp_path / "motion.json"
    path.write_text(json.dumps(frames))
    again = read_motion_file(path, TOLD).sequence
    missing = [(int(frame), int(joint)) for frame, joint in np.argwhere(~again.valid)]
    # standard joints 4 and 5 are thumb4 and index1: level joints 16 and 2
    assert missing == [(1, 16), (2, 2)]


def test_csv_columns_may_stand_in_any_order_when_they_are_named(tmp_path):
    motion = _motion()
    standard = from_level(motion.joints_m, JointOrder.STANDARD).reshape(len(motion), 63)
    names = [f"{name}_{axis}" for name in STANDARD_NAMES for axis in "xyz"]
    shuffle = np.random.default_rng(0).permutation(63)
    lines = ["time," + ",".join(names[k].upper() for k in shuffle) + ",confidence"]
    lines += [",".join(["0", *(repr(float(row[k])) for k in shuffle), "0.9"]) for row in standard]
    path = tmp_path / "motion.csv"
    path.write_text("\n".join(lines))
    again = read_motion_file(path, MotionFormat(unit="m", handedness=Handedness.RIGHT)).sequence
    assert np.array_equal(again.joints_m, motion.joints_m)


@pytest.mark.parametrize("header", ["", "frame," + ",".join(f"c{k}" for k in range(63)) + "\n"])
def test_csv_without_joint_names_is_read_in_the_declared_order(tmp_path, header):
    motion = _motion()
    listed = from_level(motion.joints_m, JointOrder.INTERHAND).reshape(len(motion), 63).tolist()
    first = "0," if header else ""
    path = tmp_path / "motion.csv"
    path.write_text(
        "# order: interhand\n" + header + "".join(first + ",".join(map(repr, row)) + "\n" for row in listed)
    )
    again = read_motion_file(path, MotionFormat(unit="m", handedness=Handedness.RIGHT)).sequence
    assert np.array_equal(again.joints_m, motion.joints_m)


@pytest.mark.parametrize("named", [True, False])
def test_a_column_of_times_is_the_clock_where_no_rate_is_declared(tmp_path, named):
    motion = _motion()
    listed = from_level(motion.joints_m, JointOrder.STANDARD).reshape(len(motion), 63).tolist()
    names = [f"{name}_{axis}" for name in STANDARD_NAMES for axis in "xyz"] if named else [f"c{k}" for k in range(63)]
    lines = [",".join(["timestamp", *names])]
    lines += [",".join([str(round(1000 * number / 120)), *map(repr, row)]) for number, row in enumerate(listed)]
    path = tmp_path / "motion.csv"
    path.write_text("\n".join(lines))
    read = read_motion_file(path, MotionFormat(unit="m", handedness=Handedness.RIGHT))
    assert read.sequence.fps == 120.0
    assert np.array_equal(read.sequence.joints_m, motion.joints_m)
    path.write_text("\n".join(["# fps: 25", *lines]))
    assert read_motion_file(path, MotionFormat(unit="m", handedness=Handedness.RIGHT)).sequence.fps == 25.0


def test_csv_errors_name_row_and_column(tmp_path):
    path = tmp_path / "motion.csv"
    write_motion(path, _motion())
    lines = path.read_text().splitlines()
    cells = lines[8].split(",")
    path.write_text("\n".join([*lines[:8], ",".join([*cells[:4], "oops", *cells[5:]]), *lines[9:]]))
    with pytest.raises(InputError, match=r"column 5: 'oops' is no number"):
        read_motion_file(path)
    path.write_text("\n".join([*lines[:8], ",".join(cells[:30]), *lines[9:]]))
    with pytest.raises(InputError, match="ends after 30 of 64 columns"):
        read_motion_file(path)


def test_masked_joints_of_an_archive_stay_missing(tmp_path):
    joints = from_level(_motion().joints_m, JointOrder.INTERHAND).copy()
    valid = np.ones(joints.shape[:2], dtype=np.uint8)
    # InterHand fills what is absent with ones: without the mask they would be joints
    joints[4, 20], valid[4, 20] = 1.0, 0
    path = tmp_path / "motion.npz"
    np.savez(path, joints=1000 * joints, valid=valid, unit="mm", order="interhand", fps=5, handedness="right")
    motion = read_motion_file(path).sequence
    assert np.argwhere(~motion.valid).tolist() == [[4, 0]]
    assert motion.fps == 5.0
    with pytest.raises(InputError, match=r"joints_m.*means meters"):
        np.savez(path, joints_m=joints, unit="mm", order="interhand", handedness="right")
        read_motion_file(path)


@pytest.mark.parametrize(
    ("what", "value"), [("unit", "inch"), ("order", "kinect"), ("handedness", "both"), ("fps", "abc"), ("fps", "nan")]
)
def test_unknown_declarations_list_the_known(tmp_path, what, value):
    told = {"order": "standard", "unit": "m", "handedness": "right", what: value}
    path = tmp_path / "motion.npz"
    np.savez(path, joints=from_level(_motion().joints_m, JointOrder.STANDARD), **told)
    with pytest.raises(InputError, match=rf"{what} of .*motion\.npz: wanted .*{value}"):
        read_motion_file(path)


def test_kinds_that_are_not_written_and_absent_files_are_named(tmp_path):
    with pytest.raises(InputError, match="No such file"):
        read_motion_file(tmp_path / "motion.npz")
    with pytest.raises(InputError, match=r"one of \.npz, \.json, \.csv"):
        write_motion(tmp_path / "motion.npy", _motion())
    with pytest.raises(InputError, match=r"one of \.npz, \.json, \.csv"):
        write_motion(tmp_path / "motion", _motion())
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "folder.json").mkdir()
    with pytest.raises(InputError, match="a folder with neither"):
        read_motion_file(tmp_path / "folder.json")


def test_real_motion_is_read(shared_data):
    path = shared_data / "real" / "human_joint_right.npy"
    read = read_motion_file(path, MotionFormat(handedness=Handedness.RIGHT))
    motion = read.sequence
    assert any("by its bones' lengths it is 'standard'" in note for note in read.notes)
    assert (len(motion), motion.fps) == (621, 30.0)
    assert not motion.gaps
    # the wrist is at the origin, the middle knuckle on +z
    assert np.abs(motion.joints_m[:, 0]).max() == 0
    assert np.abs(motion.joints_m[:, 3, :2]).max() < 1e-6
