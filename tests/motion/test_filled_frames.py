"""Frames that nobody measured are marked, in a motion and in its files."""

import numpy as np
import pytest
from tracking_samples import right_joints_m

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.files import write_motion
from jghand_engine.motion.read import read_motion_file

FILLED = np.array([False, True, True, False, False, True])


@pytest.fixture
def sequence():
    return PoseSequence(right_joints_m(6), 30.0, Handedness.RIGHT, filled=FILLED)


@pytest.mark.parametrize("suffix", [".npz", ".json", ".csv"])
def test_files_keep_the_marks(sequence, tmp_path, suffix):
    write_motion(tmp_path / f"motion{suffix}", sequence)
    np.testing.assert_array_equal(read_motion_file(tmp_path / f"motion{suffix}").sequence.filled, FILLED)


def test_a_motion_without_marks_has_no_filled_frame(tmp_path):
    plain = PoseSequence(right_joints_m(3), 30.0, Handedness.RIGHT)
    assert not plain.filled.any()
    write_motion(tmp_path / "motion.json", plain)
    assert "filled" not in (tmp_path / "motion.json").read_text()
    assert not read_motion_file(tmp_path / "motion.json").sequence.filled.any()


def test_parts_mirror_images_and_other_rates_keep_the_marks(sequence):
    np.testing.assert_array_equal(sequence.section(1, 5, 2).filled, FILLED[1:5:2])
    np.testing.assert_array_equal(sequence.mirrored().filled, FILLED)
    np.testing.assert_array_equal(sequence.with_constant_bone_lengths().filled, FILLED)
    # halfway between a filled frame and another one nobody measured either
    assert sequence.resampled(60.0).filled.tolist() == [False] + 5 * [True] + 3 * [False] + [True] * 2


def test_frames_that_hold_another_pose_are_marked():
    joints = right_joints_m(4)
    joints[2, 5] = np.nan
    held = PoseSequence(joints, 30.0, Handedness.RIGHT).with_gaps_held()
    assert held.filled.tolist() == [False, False, True, False]


@pytest.mark.parametrize("filled", [[99], [-1], ["a"], {"a": 1}, True, False, 0, [[1]], [1e400], [1.7], [True] * 6])
def test_marks_that_are_none_are_refused(sequence, tmp_path, filled):
    import json

    path = tmp_path / "motion.json"
    write_motion(path, sequence)
    document = json.loads(path.read_text())
    path.write_text(json.dumps({**document, "filled": filled}))
    with pytest.raises(InputError):
        read_motion_file(path)
