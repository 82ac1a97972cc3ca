"""Which of several hands, captures, animations of a file is taken."""

import json

import motion_samples as samples
import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.motion.choose import named
from jghand_engine.motion.content import MotionFormat
from jghand_engine.motion.read import read_motion_file

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT


def two_hands(labels):
    """Results of MediaPipe's Tasks with a right hand, then a left one, labeled so."""
    each = [
        samples.mediapipe_tasks(samples.standard(samples.motion(side)), label)
        for side, label in zip((RIGHT, LEFT), labels, strict=True)
    ]
    joined = ("landmarks", "worldLandmarks", "handedness")
    return [{**one, **{name: one[name] + other[name] for name in joined}} for one, other in zip(*each, strict=True)]


@pytest.mark.parametrize("side", [RIGHT, LEFT])
def test_of_two_hands_with_turned_labels_the_one_that_bends_so_is_taken(tmp_path, side):
    """Older versions of Tasks label both hands as their mirror images."""
    path = tmp_path / "a.json"
    path.write_text(json.dumps(two_hands(("Left", "Right"))))
    read = read_motion_file(path, MotionFormat(handedness=side))
    assert np.abs(read.sequence.joints_m - samples.motion(side).joints_m).max() < 1e-15
    assert any(f"labeled {side.other}, but its fingers bend as those of a {side} hand" in note for note in read.notes)
    kept = read_motion_file(path, MotionFormat(handedness=side, mirrored_labels=False))
    assert np.abs(kept.sequence.joints_m - samples.motion(side.other).joints_m).max() < 1e-15
    assert any("either it is one" in note for note in kept.notes)


def test_of_one_hand_what_is_said_counts_most(tmp_path):
    path = tmp_path / "a.json"
    path.write_text(json.dumps(samples.mediapipe_tasks(samples.standard(samples.motion()), "Left")))
    assert any("labeled left, but" in note for note in read_motion_file(path).notes)
    right, left = (read_motion_file(path, MotionFormat(handedness=side)) for side in (RIGHT, LEFT))
    assert (right.sequence.handedness, left.sequence.handedness) == (RIGHT, LEFT)
    assert any("labeled left: it is taken for the right one, as requested" in note for note in right.notes)
    assert any("either it is one" in note for note in left.notes)
    assert not any("it is taken for one" in note for note in (*right.notes, *left.notes))


def test_labels_that_would_make_both_hands_the_same_one_stay(tmp_path):
    """One hand bends as the other: nobody knows which label is wrong."""
    frames = two_hands(("Right", "Left"))
    right = samples.standard(samples.motion(RIGHT)).tolist()
    for frame, joints in zip(frames, right, strict=True):
        frame["worldLandmarks"][1] = [{"x": x, "y": y, "z": z} for x, y, z in joints]
    (tmp_path / "a.json").write_text(json.dumps(frames))
    read = read_motion_file(tmp_path / "a.json", MotionFormat(handedness=LEFT))
    assert read.sequence.handedness is LEFT
    assert any("bend as those of a right hand" in note for note in read.notes)


def test_a_name_that_begins_another_one_is_chosen():
    captures = [f"Capture{number}, {side} hand" for number in (1, 10, 26) for side in Handedness]
    assert named("capture1", captures) == [0, 1]
    assert named("Capture1, left hand", captures) == [1]
    assert named("26", captures) == [4, 5]
    assert named("Walk", ["WalkFast", "Walk"]) == [1]
    assert named("fast", ["WalkFast", "Walk"]) == [0]
    assert named("run", ["WalkFast", "Walk"]) == []


def test_frames_that_interhand_leaves_out_are_gaps_and_a_jump_begins_another_sequence(tmp_path):
    document = samples.interhand_document(samples.motion())
    for number in (5, 6, 7):
        del document["0"][str(20 + 3 * number)]
    path = tmp_path / "joint_3d.json"
    path.write_text(json.dumps(document))
    assert read_motion_file(path).sequence.gaps.frames == (5, 6, 7)
    later = samples.interhand_document(samples.motion(frames=12))["0"]
    document["0"] |= {str(int(name) + 9000): frame for name, frame in later.items()}
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=r"got 2: Capture0, from 20, .*, from 9020.*--part"):
        read_motion_file(path)
    assert len(read_motion_file(path, MotionFormat(part="Capture0, from 9020")).sequence) == 12
    assert len(read_motion_file(path, MotionFormat(part="from 20,")).sequence) == 40


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"Kaydara FBX Binary  \x00", r"\.any: FBX is not read: export BVH"),
        (b"", r"\.any: it is empty\."),
        (b'{"people": []}', r"\.any: no keypoints of hands in it"),
        (b'[{"worldLandmarks": [], "landmarks": [[1]]}]', r"\.any: it holds landmarks of the image only"),
    ],
)
def test_a_good_file_is_not_called_damaged(tmp_path, content, says):
    (tmp_path / "motion.any").write_bytes(content)
    with pytest.raises(InputError, match=says) as caught:
        read_motion_file(tmp_path / "motion.any")
    assert "damaged" not in str(caught.value)


def test_a_part_that_is_in_no_file_of_one_hand_is_refused(tmp_path):
    samples.write_bvh(tmp_path / "a.bvh", samples.rig(samples.motion(), scale=100))
    with pytest.raises(InputError, match="a part called 'nonsense', got Mixamo"):
        read_motion_file(tmp_path / "a.bvh", MotionFormat(part="nonsense"))


@pytest.mark.parametrize(
    "column", ["{name}_{axis}", "{name}.{axis}", "{name} {axis}", "{name}-{axis}", "{name}.{axis_}"]
)
def test_columns_of_a_table_part_axes_in_any_way_and_its_clock_counts(tmp_path, column):
    motion = samples.motion(fps=120.0)
    names = [f"right_hand_{name}" for name in samples.MEDIAPIPE_NAMES]
    header = [column.format(name=name, axis=axis, axis_=axis.upper()) for name in names for axis in "xyz"]
    rows = samples.standard(motion).reshape(len(motion), -1).tolist()
    lines = [",".join(["timestamp", *header])]
    lines += [",".join([repr(number / 120), *map(repr, row)]) for number, row in enumerate(rows)]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    read = read_motion_file(tmp_path / "a.csv")
    assert (read.kind, read.sequence.fps, read.sequence.handedness) == ("a table of joints", 120.0, RIGHT)
    assert np.abs(read.sequence.joints_m - motion.joints_m).max() < 1e-15


def test_one_pose_of_a_headset_is_none_of_our_own_files(tmp_path):
    motion = samples.motion(frames=1)
    joints = [dict(zip("xyz", point, strict=True)) for point in samples.webxr_joints(motion)[0].tolist()]
    (tmp_path / "a.json").write_text(json.dumps({"handedness": "right", "joints": joints}))
    read = read_motion_file(tmp_path / "a.json")
    assert read.kind == "joints of a headset"
    assert np.abs(read.sequence.joints_m - motion.joints_m).max() < 1e-15


def test_a_plain_array_that_says_no_rate_is_told_its_own(tmp_path):
    np.save(tmp_path / "a.npy", samples.standard(samples.motion()))
    told = MotionFormat(handedness=RIGHT)
    assert any("30 are taken; --fps" in note for note in read_motion_file(tmp_path / "a.npy", told).notes)
    (tmp_path / "a.json").write_text(json.dumps(samples.standard(samples.motion()).tolist()))
    assert any("30 are taken; --fps" in note for note in read_motion_file(tmp_path / "a.json", told).notes)
