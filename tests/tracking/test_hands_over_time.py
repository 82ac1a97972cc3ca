"""Which detection is which hand."""

import numpy as np
import pytest
from tracking_samples import FPS, right_joints_m, seen

from jghand_engine.hand.joints import Handedness
from jghand_engine.tracking.hands_over_time import hands_over_time, shape_rightness

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT
JOINTS_M = right_joints_m(40)
# a left hand beside it
LEFT_M = JOINTS_M * (-1, 1, 1) - (0.25, 0, 0)


def test_two_hands_are_kept_apart():
    frames = [
        [seen(a, RIGHT), seen(b, LEFT)][:: 1 if k % 2 else -1]
        for k, (a, b) in enumerate(zip(JOINTS_M, LEFT_M, strict=True))
    ]
    found = hands_over_time(frames, FPS)
    assert set(found) == {RIGHT, LEFT}
    for side, hand in found.items():
        assert hand.seen.all()
        assert all(one.handedness is side for one in hand.frames)


def test_a_hand_that_is_called_the_other_one_now_and_then_stays_what_it_mostly_is():
    labels = [LEFT if k % 5 == 2 else RIGHT for k in range(40)]
    found = hands_over_time([[seen(joints, label)] for joints, label in zip(JOINTS_M, labels, strict=True)], FPS)
    assert set(found) == {RIGHT}
    assert found[RIGHT].seen.all()
    assert found[RIGHT].relabelled == 8


def test_the_way_that_fingers_bend_tells_the_hand():
    assert shape_rightness(JOINTS_M[10]) > 0.3
    assert shape_rightness(JOINTS_M[10] * (-1, 1, 1)) < -0.3


def test_a_label_that_is_wrong_half_of_the_time_is_outvoted_by_the_shape():
    labels = [LEFT if k % 2 else RIGHT for k in range(40)]
    frames = [[seen(joints, label)] for joints, label in zip(JOINTS_M * (-1, 1, 1), labels, strict=True)]
    assert set(hands_over_time(frames, FPS)) == {LEFT}


def test_one_hand_found_twice_is_one_hand():
    """The second time as its own mirror image, less surely: by itself it would be a left hand."""
    middle = JOINTS_M.mean(1, keepdims=True)
    mirrored = (JOINTS_M - middle) * (-1, 1, 1) + middle
    frames = [[seen(b, LEFT, 0.6), seen(a, RIGHT)] for a, b in zip(JOINTS_M, mirrored, strict=True)]
    found = hands_over_time(frames, FPS)
    assert set(found) == {RIGHT}
    assert found[RIGHT].relabelled == 0


def test_a_hand_that_was_away_is_the_same_one_again():
    frames = [[seen(joints, RIGHT)] if not 15 <= k < 33 else [] for k, joints in enumerate(JOINTS_M)]
    found = hands_over_time(frames, FPS)
    assert set(found) == {RIGHT}
    assert found[RIGHT].seen.sum() == 22


def test_a_second_right_hand_is_another_persons_and_left_out():
    frames = [[seen(joints, RIGHT), seen(joints + np.array([0.25, 0.0, 0.0]), RIGHT)] for joints in JOINTS_M]
    frames[0] = frames[0][:1]
    found = hands_over_time(frames, FPS)
    middles = [hand.middle_px[0] for hand in found[RIGHT].frames]
    assert np.ptp(middles) < 100, "it does not jump from one to the other"


@pytest.mark.parametrize("count", [1, 2])
def test_what_is_hardly_ever_seen_is_taken_for_a_mistake(count):
    frames = [
        [seen(joints, RIGHT)] + ([seen(LEFT_M[k], LEFT)] if k < count else []) for k, joints in enumerate(JOINTS_M)
    ]
    assert set(hands_over_time(frames, FPS)) == {RIGHT}


def test_a_single_picture_counts():
    assert set(hands_over_time([[seen(JOINTS_M[0], RIGHT)]], FPS)) == {RIGHT}


def test_without_hands_there_is_nothing():
    assert hands_over_time([[], [], []], FPS) == {}
    assert hands_over_time([], FPS) == {}
