"""Motions: validation, gaps, constant bone lengths, resampling, mirroring."""

from dataclasses import replace

import numpy as np
import pytest
from hand import sampled_hands as hands
from hypothesis import given, settings
from hypothesis import strategies as st

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, bone_lengths, to_level
from jghand_engine.hand.poses import pose_sequence_of_names
from jghand_engine.hand.sequence import PoseSequence, bone_directions

RIGHT = Handedness.RIGHT


def _moving(frames=40):
    return pose_sequence_of_names(["open", "fist", "open"], hands.canonical_np(), handedness=Handedness.RIGHT).section(
        0, frames
    )


def _wobbling(frames=40, wobble_m=0.003):
    sequence = _moving(frames)
    noise = wobble_m * np.random.default_rng(0).standard_normal(sequence.joints_m.shape)
    return PoseSequence(sequence.joints_m + noise, sequence.fps, RIGHT)


def _with_gaps(**missing):
    """Frame numbers by joint number, for example j3=[0, 5]."""
    sequence = _moving()
    joints = sequence.joints_m.copy()
    for name, frames in missing.items():
        joints[frames, int(name[1:])] = np.nan
    return PoseSequence(joints, sequence.fps, RIGHT), sequence


@pytest.mark.parametrize(
    ("joints", "says"),
    [
        (np.zeros((5, 20, 3)), "One joint is missing"),
        (np.zeros((5, 42, 3)), "two hands of InterHand2.6M"),
        (np.zeros((0, 21, 3)), "empty motion"),
        (np.zeros((21, 3)), "shape"),
        (np.zeros((5, 21, 2)), "shape"),
        ("nonsense", "numbers"),
        (np.array([[[None] * 3] * 21, [["a"] * 3] * 21]), "numbers"),
    ],
)
def test_what_is_no_motion_is_refused(joints, says):
    with pytest.raises(InputError, match=says):
        PoseSequence(joints, 30.0, RIGHT)


@pytest.mark.parametrize("fps", [0.0, -30.0, float("nan"), float("inf"), 1e9])
def test_impossible_rates_are_refused(fps):
    with pytest.raises(InputError, match="frames per second"):
        PoseSequence(np.zeros((2, 21, 3)), fps, RIGHT)
    with pytest.raises(InputError, match="frames per second"):
        _moving().resampled(fps)


def test_a_sequence_owns_its_numbers():
    joints = _moving().joints_m.copy()
    sequence = PoseSequence(joints, 30, "right")
    joints[:] = 0
    assert np.abs(sequence.joints_m).max() > 0
    assert sequence.joints_m.dtype == np.float64
    assert sequence.handedness is RIGHT
    assert sequence.duration_s == (len(sequence) - 1) / 30


def test_invalid_joints_are_poisoned_and_bad_numbers_invalid():
    sequence = _moving()
    valid = np.ones((len(sequence), 21), dtype=bool)
    valid[3, 7] = False
    joints = sequence.joints_m.copy()
    joints[4, 8, 1] = np.inf
    marked = PoseSequence(joints, 30.0, RIGHT, valid)
    assert np.isnan(marked.joints_m[3, 7]).all()
    assert np.isnan(marked.joints_m[4, 8]).all()
    assert np.argwhere(~marked.valid).tolist() == [[3, 7], [4, 8]]
    with pytest.raises(InputError, match="valid joints"):
        PoseSequence(joints, 30.0, RIGHT, valid[:, :20])


def test_gaps_are_counted_with_frames_and_joints():
    broken, _ = _with_gaps(j3=[0, 5], j20=[5, 6, 7, 39])
    gaps = broken.gaps
    assert gaps.frames == (0, 5, 6, 7, 39)
    assert gaps.joints == {"middle1": 2, "pinky4": 4}
    assert gaps.longest == 3
    assert gaps
    assert gaps.sentence() == (
        "5 of 40 frames miss joints (frames 0, 5, 6, 7, 39; joints pinky4, middle1; longest gap 3)"
    )


def test_a_whole_motion_has_no_gaps():
    sequence = _moving()
    assert not sequence.gaps
    assert sequence.gaps.sentence() == ""
    assert sequence.without_gaps() is sequence


def test_gaps_hold_the_last_whole_pose_and_at_the_start_the_first():
    broken, whole = _with_gaps(j3=[0, 1, 5], j20=[5, 6, 39])
    held = broken.with_gaps_held()
    assert not held.gaps
    source = np.arange(40)
    source[[0, 1]] = 2
    source[[5, 6]] = 4
    source[39] = 38
    assert np.array_equal(held.joints_m, whole.joints_m[source])


def test_gaps_can_be_refused():
    broken, _ = _with_gaps(j3=[4])
    with pytest.raises(InputError, match=r"1 of 40 frames miss joints \(frames 4; joints middle1"):
        broken.without_gaps()


def test_a_motion_without_one_whole_frame_cannot_be_held():
    broken, _ = _with_gaps(j20=list(range(40)))
    with pytest.raises(InputError, match="Missing: pinky4"):
        broken.with_gaps_held()


def test_constant_lengths_are_the_medians_and_directions_stay():
    wobbling = _wobbling()
    steady = wobbling.with_constant_bone_lengths()
    median = np.median(wobbling.bone_lengths_m, axis=0)
    assert np.ptp(wobbling.bone_lengths_m, axis=0).min() > 0.002
    assert np.abs(steady.bone_lengths_m - median).max() < 1e-15
    assert np.abs(bone_directions(steady.joints_m) - bone_directions(wobbling.joints_m)).max() < 1e-12
    assert np.array_equal(steady.joints_m[:, 0], wobbling.joints_m[:, 0])


def test_a_vanished_bone_keeps_its_direction_of_the_frame_before():
    sequence = _moving()
    joints = sequence.joints_m.copy()
    joints[10, 17] = joints[10, 12]
    joints[0, 16] = joints[0, 11]
    steady = PoseSequence(joints, 30.0, RIGHT).with_constant_bone_lengths()
    directions = bone_directions(sequence.joints_m)
    assert np.abs(bone_directions(steady.joints_m)[10, 16] - directions[9, 16]).max() < 1e-12
    # at the start there is no frame before: the next one that has the bone
    assert np.abs(bone_directions(steady.joints_m)[0, 15] - directions[1, 15]).max() < 1e-12
    assert np.ptp(steady.bone_lengths_m, axis=0).max() < 1e-15


def test_a_bone_that_never_has_a_length_is_named():
    joints = _moving().joints_m.copy()
    joints[:, 17] = joints[:, 12]
    with pytest.raises(InputError, match="none at index4"):
        PoseSequence(joints, 30.0, RIGHT).with_constant_bone_lengths()


def test_a_bone_that_no_frame_shows_is_named():
    broken, _ = _with_gaps(j8=list(range(40)))
    with pytest.raises(InputError, match="none with middle2"):
        broken.with_constant_bone_lengths()


def test_constant_lengths_leave_gaps_as_gaps():
    broken, _ = _with_gaps(j8=[4])
    steady = broken.with_constant_bone_lengths()
    # the joint that is missing, and what hangs on it
    assert np.flatnonzero(~steady.valid[4]).tolist() == [8, 13, 18]


def test_doubling_the_rate_keeps_every_frame_and_halving_it_again_gives_the_motion():
    sequence = _wobbling()
    doubled = sequence.resampled(2 * sequence.fps)
    assert len(doubled) == 2 * len(sequence) - 1
    assert np.abs(doubled.joints_m[::2] - sequence.joints_m).max() < 1e-15
    assert np.abs(doubled.resampled(sequence.fps).joints_m - sequence.joints_m).max() < 1e-15


@settings(max_examples=50, deadline=None)
@given(fps=st.floats(1.0, 500.0), frames=st.integers(1, 30))
def test_any_rate_keeps_duration_and_bone_lengths(fps, frames):
    sequence = _moving(frames)
    other = sequence.resampled(fps)
    assert other.fps == fps
    assert np.array_equal(other.joints_m[0], sequence.joints_m[0])
    # the last frame is less than one frame before the end, and never after it
    assert -1e-6 / fps <= sequence.duration_s - other.duration_s < 1 / fps
    assert np.abs(other.bone_lengths_m - sequence.bone_lengths_m[0]).max() < 1e-12


def test_resampling_leaves_gaps_where_they_were():
    broken, _ = _with_gaps(j8=[4])
    doubled = broken.resampled(2 * broken.fps)
    missing = np.flatnonzero(~doubled.valid.all(axis=1))
    assert missing.tolist() == [7, 8, 9]


def test_a_forearm_turns_with_the_frames_whatever_is_done_to_them():
    angle_rad = np.linspace(0, 1, 40)
    turns = np.stack([np.cos(angle_rad / 2), *np.zeros((2, 40)), np.sin(angle_rad / 2)], 1)
    # of the two quaternions of a rotation any is the same
    motion = replace(_moving(), forearm=turns * np.where(np.arange(40) % 3, 1, -1)[:, None])
    np.testing.assert_allclose(motion.forearm, turns)
    np.testing.assert_allclose(motion.resampled(2 * motion.fps).forearm[::2], turns, atol=1e-12)
    np.testing.assert_allclose(motion.resampled(2 * motion.fps).forearm[1, 3], np.sin(angle_rad[1] / 4))
    np.testing.assert_allclose(motion.section(3, 20, 4).forearm, turns[3:20:4])
    # in the axes of the palm, of a right hand
    np.testing.assert_allclose(motion.mirrored().forearm, turns)
    gap = motion.joints_m.copy()
    gap[7] = np.nan
    held = replace(motion, joints_m=gap, valid=None).with_gaps_held()
    np.testing.assert_allclose(held.forearm[7], turns[6])
    with pytest.raises(InputError, match="forearm"):
        replace(motion, forearm=turns[1:])


def test_a_joint_beyond_a_missing_one_goes_straight_between_frames():
    broken, _ = _with_gaps(j8=[4])
    doubled = broken.resampled(2 * broken.fps)
    beyond = broken.joints_m[:, [13, 18]]  # further out on the finger of joint 8
    np.testing.assert_allclose(doubled.joints_m[7, [13, 18]], (beyond[3] + beyond[4]) / 2, atol=1e-15)
    quarter = broken.resampled(4 * broken.fps)
    np.testing.assert_allclose(quarter.joints_m[13, [13, 18]], 0.75 * beyond[3] + 0.25 * beyond[4], atol=1e-15)


def test_mirroring_twice_is_the_motion_itself():
    sequence = _moving()
    left = sequence.mirrored()
    assert left.handedness is Handedness.LEFT
    assert np.array_equal(left.joints_m, sequence.joints_m * [-1, 1, 1])
    assert left.mirrored().handedness is RIGHT
    assert np.array_equal(left.mirrored().joints_m, sequence.joints_m)


def test_sections_follow_the_step_in_rate():
    sequence = _moving()
    part = sequence.section(4, 20, 3)
    assert np.array_equal(part.joints_m, sequence.joints_m[4:20:3])
    assert part.fps == sequence.fps / 3
    for bad in ((50, 60, 1), (5, 5, 1), (0, 10, 0)):
        with pytest.raises(InputError, match="frames"):
            sequence.section(*bad)


def test_real_motion_stops_pulsing(shared_data):
    joints = np.load(shared_data / "real" / "human_joint_right.npy", allow_pickle=False)
    real = PoseSequence(to_level(joints, JointOrder.STANDARD), 30.0, RIGHT)
    assert not real.gaps
    steady = real.with_constant_bone_lengths()
    # DATA 11: bones vary by millimeters over time, the whole hand (s_g) by per cent
    whole = [sequence.bone_lengths_m.sum(axis=1) for sequence in (real, steady)]
    assert real.bone_lengths_m.std(axis=0).max() > 0.004
    assert np.ptp(whole[0]) / whole[0].mean() > 0.05
    assert steady.bone_lengths_m.std(axis=0).max() < 1e-14
    assert np.ptp(whole[1]) / whole[1].mean() < 1e-14
    # and it is still the same motion
    assert np.abs(bone_directions(steady.joints_m) - bone_directions(real.joints_m)).max() < 1e-12
    assert np.abs(steady.joints_m - real.joints_m).mean() < 0.004
    assert np.allclose(bone_lengths(steady.joints_m[0]), np.median(real.bone_lengths_m, axis=0))
