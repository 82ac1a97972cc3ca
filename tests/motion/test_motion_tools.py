"""Gaps, cuts, other times: bones turn and keep their lengths."""

import motion_samples
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion.repair import fill_gaps
from jghand_engine.motion.tools import cut, in_place, retimed, turned_up, with_hand_length


def _turning(frames=31, degrees=120.0):
    """A stiff hand that turns evenly about an axis that is none of its own."""
    still = motion_samples.motion().joints_m[0]
    axis = np.array([1.0, 2.0, -0.5]) / np.linalg.norm([1.0, 2.0, -0.5])
    turns = Rotation.from_rotvec(np.radians(np.linspace(0, degrees, frames))[:, None] * axis).as_matrix()
    return PoseSequence(np.einsum("fij,kj->fki", turns, still - still[0]), 30.0, motion_samples.motion().handedness)


def _without(sequence, frames, joints=slice(None)):
    missing = sequence.joints_m.copy()
    missing[np.ix_(range(*frames.indices(len(missing))), np.arange(21)[joints])] = np.nan
    return PoseSequence(missing, sequence.fps, sequence.handedness)


def test_a_hand_that_was_lost_while_it_turned_comes_back_as_it_was():
    whole = _turning()
    filled = fill_gaps(_without(whole, slice(5, 25)))
    # stiff and evenly turning, the way between is the truth; worst seen 5e-16 m
    np.testing.assert_allclose(filled.sequence.joints_m, whole.joints_m, atol=2e-15)
    assert filled.sequence.filled.tolist() == [5 <= frame < 25 for frame in range(31)]


def test_a_hidden_finger_goes_along_with_the_palm_that_was_seen():
    whole = _turning()
    filled = fill_gaps(_without(whole, slice(0, 12), [7, 12, 17])).sequence
    np.testing.assert_allclose(filled.joints_m, whole.joints_m, atol=2e-15)


def test_joints_that_were_seen_are_not_moved():
    whole = motion_samples.motion()
    gappy = _without(whole, slice(8, 14), [3, 8, 13, 18])
    filled = fill_gaps(gappy).sequence
    assert np.array_equal(filled.joints_m[gappy.valid], whole.joints_m[gappy.valid])
    assert np.isfinite(filled.joints_m).all()


def test_filled_fingers_keep_their_lengths():
    whole = motion_samples.motion()
    lengths = bone_lengths(fill_gaps(_without(whole, slice(6, 30))).sequence.joints_m)
    # worst seen 1e-16 m
    assert np.ptp(lengths, axis=0).max() < 1e-15


def test_gaps_at_both_ends_hold_what_is_next_to_them():
    whole = motion_samples.motion()
    filled = fill_gaps(_without(_without(whole, slice(0, 4)), slice(36, 40))).sequence.joints_m
    np.testing.assert_allclose(filled[0], whole.joints_m[4], atol=1e-15)
    np.testing.assert_allclose(filled[-1], whole.joints_m[35], atol=1e-15)


def test_a_long_gap_says_that_nobody_knows():
    whole = motion_samples.motion(frames=80)
    assert "not known" in fill_gaps(_without(whole, slice(10, 40))).sentence()
    assert "not known" not in fill_gaps(_without(whole, slice(10, 14))).sentence()


@pytest.mark.parametrize(("joints", "says"), [([0], "the wrist"), ([7], "the bone to index2")])
def test_what_is_in_no_frame_cannot_be_filled(joints, says):
    with pytest.raises(InputError, match=says):
        fill_gaps(_without(motion_samples.motion(), slice(None), joints))


def test_a_cut_keeps_both_ends():
    motion = motion_samples.motion()
    part = cut(motion, 0.1, 0.5)
    assert np.array_equal(part.joints_m, motion.joints_m[3:16])
    assert len(cut(motion, end_s=100.0)) == len(motion)
    assert len(cut(motion)) == len(motion)


@pytest.mark.parametrize(("start", "end"), [(-1, None), (float("nan"), None), (0.5, 0.4), (100, None), (None, -0.1)])
def test_a_cut_without_a_frame_is_refused(start, end):
    with pytest.raises(InputError, match="cut"):
        cut(motion_samples.motion(), start, end)


def test_resampling_a_turning_hand_neither_shrinks_nor_bends_it():
    whole = _turning(frames=61)
    coarse = whole.section(step=15)
    again = coarse.resampled(30.0)
    # four steps of 30 degrees; positions between them are up to 4.6 mm off
    np.testing.assert_allclose(again.joints_m, whole.joints_m, atol=2e-15)
    linear = 0.5 * (coarse.joints_m[0] + coarse.joints_m[1])
    assert np.abs(linear - coarse.resampled(4.0).joints_m[1]).max() > 3e-3


def test_uneven_times_become_even_ones():
    whole = _turning(frames=61)
    random = np.random.default_rng(0)
    kept = np.sort(np.concatenate([[0, 60], random.choice(np.arange(1, 60), 45, replace=False)]))
    again, _ = retimed(whole.joints_m[kept], kept / 30.0, 30.0)
    assert np.flatnonzero(np.isfinite(again).all(axis=(1, 2))).tolist() == kept.tolist()
    again = fill_gaps(PoseSequence(again, 30.0, whole.handedness)).sequence
    assert again.filled.sum() == 61 - len(kept)
    np.testing.assert_allclose(again.joints_m, whole.joints_m, atol=2e-15)


def test_a_missing_hand_is_missing_between_its_neighbors_only():
    joints = _turning().joints_m.copy()
    joints[10] = np.nan
    # every other frame is late by a quarter: frame 11 is to be between the 10th and the 11th
    times_s = (np.arange(31) + 0.25 * (np.arange(31) % 2)) / 30.0
    again, _ = retimed(joints, times_s, 30.0)
    assert np.flatnonzero(np.isnan(again).any(axis=(1, 2))).tolist() == [10, 11]


@pytest.mark.parametrize("times", [[0, 1, 1], [0, 2, 1], [0, 1, np.nan]])
def test_times_that_are_no_times_are_refused(times):
    with pytest.raises(InputError, match="times"):
        retimed(_turning(3).joints_m, np.array(times, dtype=float), 30.0)


def test_in_place_the_wrist_stays_and_the_hand_turns():
    motion = motion_samples.motion()
    still = in_place(motion)
    assert np.ptp(still.joints_m[:, 0], axis=0).max() == 0
    bones = still.joints_m - still.joints_m[:, :1]
    np.testing.assert_allclose(bones, motion.joints_m - motion.joints_m[:, :1], atol=1e-15)


@pytest.mark.parametrize(("up", "wanted"), [("y", "z"), ("z", "y"), ("-y", "y"), ("-y", "z"), ("y", "y")])
def test_what_points_up_points_up_afterwards(up, wanted):
    axes = {"y": np.array([0, 1, 0]), "z": np.array([0, 0, 1]), "-y": np.array([0, -1, 0])}
    motion = motion_samples.motion()
    turned = turned_up(motion, up, wanted)
    assert np.array_equal(turned.joints_m @ axes[wanted], motion.joints_m @ axes[up])
    assert np.array_equal(turned.joints_m[..., 0], motion.joints_m[..., 0])
    # turned, not mirrored
    first, second = (np.linalg.det(one.joints_m[0, [1, 5, 9]] - one.joints_m[0, 0]) for one in (motion, turned))
    assert first == pytest.approx(second)


def test_a_hand_gets_the_length_that_is_said():
    assert hand_length(with_hand_length(motion_samples.motion(), 0.15).joints_m) == pytest.approx(0.15)
    with pytest.raises(InputError, match="length of the hand"):
        with_hand_length(motion_samples.motion(), 15.0)


@pytest.mark.parametrize("lost", [[7], [12], [2], [7, 12], [2, 7], [2, 7, 12]])
def test_joints_lost_between_two_that_were_seen_keep_the_bones_lengths(lost):
    """The index finger's joints, its tip seen throughout: wrong by what nobody saw, but never stretched."""
    whole = motion_samples.motion()
    gappy = _without(whole, slice(6, 30), lost)
    filled = fill_gaps(gappy).sequence
    assert np.array_equal(filled.joints_m[gappy.valid], whole.joints_m[gappy.valid])
    # worst seen 4e-16 m; interpolation alone changes lengths by up to 36 mm here
    assert np.ptp(bone_lengths(filled.joints_m), axis=0).max() < 1e-15


@pytest.mark.parametrize("frames", [slice(5, 13), slice(6, 31), slice(20, 39), slice(0, 8), slice(30, 40)])
def test_a_wrist_lost_alone_lies_to_the_knuckles_as_it_did(frames):
    """The palm of the sample is stiff; on a straight way the wrist would be up to 105 mm off."""
    whole = motion_samples.motion()
    filled = fill_gaps(_without(whole, frames, [0])).sequence
    # worst seen 7e-16 m
    np.testing.assert_allclose(filled.joints_m, whole.joints_m, rtol=0, atol=1e-15)


def test_a_finger_that_is_stretched_too_far_is_straight():
    """What was seen cannot be reached with bones of their lengths: they lie on the line."""
    whole = _turning(5, 0.0)
    joints = whole.joints_m.copy()
    joints[2, [12, 17]] += 0.05 * (joints[2, [12, 17]] - joints[2, [2]]) / np.linalg.norm(joints[2, 12] - joints[2, 2])
    stretched = PoseSequence(joints, whole.fps, whole.handedness)
    filled = fill_gaps(_without(stretched, slice(2, 3), [7])).sequence.joints_m[2]
    first, second = filled[7] - filled[2], filled[12] - filled[7]
    # the height of a flat triangle is the root of round-off: 1.5e-8 of a bone, on another processor 0
    assert np.linalg.norm(np.cross(first, second)) < 1e-10
    assert np.linalg.norm(first) == pytest.approx(bone_lengths(whole.joints_m)[0, 6])


def test_a_hole_of_the_clock_is_a_gap():
    joints = _turning(61).joints_m
    kept = np.r_[0:20, 40:61]
    again, _ = retimed(joints[kept], kept / 30.0 + 1e-3 * np.abs(np.sin(kept)), 30.0)
    missing = np.flatnonzero(np.isnan(again).any(axis=(1, 2)))
    assert missing.tolist() == list(range(20, 40))
    # the hand turns by 2 degrees a frame, its clock wobbles by a millisecond: worst seen
    # 1.4e-4 m
    np.testing.assert_allclose(np.delete(again, missing, 0), np.delete(joints, missing, 0), rtol=0, atol=2e-4)


def test_a_joint_beyond_a_missing_one_is_not_lost_at_another_rate():
    whole = _turning(21)
    gappy = _without(whole, slice(10, 11), [7])
    doubled = gappy.resampled(60.0)
    assert np.argwhere(~doubled.valid).tolist() == [[19, 7], [20, 7], [21, 7]]
    fine = whole.resampled(60.0).joints_m
    # the fingertip goes along a straight line for 6 degrees: worst seen 1.7e-4 m
    np.testing.assert_allclose(doubled.joints_m[doubled.valid], fine[doubled.valid], rtol=0, atol=2e-4)
