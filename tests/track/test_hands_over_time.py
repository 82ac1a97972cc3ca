"""Which detection is which hand."""

import numpy as np
import pytest
from tracking_samples import FPS, right_joints_m, seen

from jghand_engine.hand.joints import Handedness
from jghand_engine.track import hands_over_time as module
from jghand_engine.track.hands_over_time import shape_rightness

RIGHT, LEFT = Handedness.RIGHT, Handedness.LEFT
JOINTS_M = right_joints_m(40)
# a left hand beside it
LEFT_M = JOINTS_M * (-1, 1, 1) - (0.25, 0, 0)


def hands_over_time(frames, fps):
    """The hands that are believed."""
    return module.hands_over_time(frames, fps).hands


def labels(hand):
    """One letter a picture: what the detector called what was taken for this hand; - where it was not seen."""
    return "".join("-" if one is None else one.handedness.value[0] for one in hand.frames)


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
    called = [LEFT if k % 5 == 2 else RIGHT for k in range(40)]
    found = hands_over_time([[seen(joints, label)] for joints, label in zip(JOINTS_M, called, strict=True)], FPS)
    assert set(found) == {RIGHT}
    assert found[RIGHT].seen.all()
    assert found[RIGHT].relabeled == 8


def test_the_way_that_fingers_bend_tells_the_hand():
    assert shape_rightness(JOINTS_M[10]) > 0.3
    assert shape_rightness(JOINTS_M[10] * (-1, 1, 1)) < -0.3


def test_a_label_that_is_wrong_half_of_the_time_is_outvoted_by_the_shape():
    called = [LEFT if k % 2 else RIGHT for k in range(40)]
    frames = [[seen(joints, label)] for joints, label in zip(JOINTS_M * (-1, 1, 1), called, strict=True)]
    assert set(hands_over_time(frames, FPS)) == {LEFT}


def test_one_hand_found_twice_is_one_hand():
    """The second time as its own mirror image, less surely: by itself it would be a left hand."""
    middle = JOINTS_M.mean(1, keepdims=True)
    mirrored = (JOINTS_M - middle) * (-1, 1, 1) + middle
    frames = [[seen(b, LEFT, 0.6), seen(a, RIGHT)] for a, b in zip(JOINTS_M, mirrored, strict=True)]
    found = hands_over_time(frames, FPS)
    assert set(found) == {RIGHT}
    assert found[RIGHT].relabeled == 0


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


@pytest.mark.parametrize("gone", [20, 30])
def test_two_hands_that_come_and_go_together_are_two_hands(gone):
    frames = [[seen(a, RIGHT), seen(b, LEFT)] for a, b in zip(JOINTS_M, LEFT_M, strict=True)]
    found = hands_over_time(frames[:10] + [[]] * gone + frames[10:], FPS)
    assert set(found) == {RIGHT, LEFT}
    for hand in found.values():
        assert hand.seen.sum() == 40
        assert hand.relabeled == 0


@pytest.mark.parametrize("half_m", [0.01, 0.03, 0.06])
def test_hands_that_pass_in_front_of_each_other_stay_themselves(half_m):
    """The right one is in front, so it alone is seen; then the left one alone, nearer to where the right one was."""
    joints, x = right_joints_m(120), np.linspace(-0.2, 0.2, 120)
    frames = []
    for k in range(120):
        right, left = seen(joints[k] + (x[k], 0, 0), RIGHT), seen(joints[k] * (-1, 1, 1) - (x[k], 0, 0), LEFT)
        frames.append([right, left] if abs(x[k]) > half_m else [right] if x[k] < 0 else [left])
    found = hands_over_time(frames, FPS)
    assert {side: set(labels(hand)) for side, hand in found.items()} == {RIGHT: {"r", "-"}, LEFT: {"l", "-"}}
    assert all(hand.certainty > 0.9 for hand in found.values())


def test_a_hand_that_appears_where_the_other_one_was_is_not_the_other_one():
    """The left one comes to a third of its size from where the right one is hidden by it."""
    there = seen(JOINTS_M[0], RIGHT)
    beside, over = (seen(JOINTS_M[0] * (-1, 1, 1) + (x, 0, 0), LEFT) for x in (0.07, 0.005))
    frames = [[there, beside]] * 20 + [[over]] * 10 + [[there, beside]] * 20
    found = hands_over_time(frames, FPS)
    assert labels(found[RIGHT]) == 20 * "r" + 10 * "-" + 20 * "r"
    assert labels(found[LEFT]) == 50 * "l"


def test_a_detection_that_is_wrong_once_costs_no_more_than_its_picture():
    joints = right_joints_m(200)
    frames = [[seen(joints[k] + (0.06 if k >= 100 else 0, 0, 0), RIGHT)] for k in range(200)]
    # nearer to where the hand was than the hand itself, which jumped
    frames[100].append(seen(joints[99] - (0.005, 0, 0), RIGHT, 0.6))
    assert hands_over_time(frames, FPS)[RIGHT].seen.all()


@pytest.mark.parametrize(("begin", "end", "crossed"), [(30, 40, 80), (30, 55, 90)])
def test_what_was_wrongly_seen_long_ago_does_not_take_over_the_hand_that_comes_there(begin, end, crossed):
    joints, x = right_joints_m(240), np.linspace(-0.2, 0.2, 240)
    way = [seen(joints[k] + (x[k], 0, 0), RIGHT) for k in range(240)]
    frames = [[hand] + ([way[crossed]] if begin <= k < end else []) for k, hand in enumerate(way)]
    found = hands_over_time(frames, FPS)
    assert set(found) == {RIGHT}
    assert all(mine is hand for mine, hand in zip(found[RIGHT].frames, way, strict=True))


@pytest.mark.parametrize("gone", [0, 1, 3, 9, 15, 18])
def test_a_right_hand_that_leaves_and_a_left_one_that_comes_at_once_are_two_hands(gone):
    joints = right_joints_m(90)
    frames = [[seen(one, RIGHT)] for one in joints] + [[]] * gone
    # a little more than a step away where there is no pause at all
    beside = (0.25 if gone == 0 else 0.12, 0, 0)
    frames += [[seen(one * (-1, 1, 1) + beside, LEFT)] for one in joints]
    found = hands_over_time(frames, FPS)
    assert {side: labels(hand) for side, hand in found.items()} == {
        RIGHT: 90 * "r" + (gone + 90) * "-",
        LEFT: (90 + gone) * "-" + 90 * "l",
    }


@pytest.mark.parametrize("gone", [20, 30, 50])
def test_a_hand_that_comes_while_the_other_one_is_away_is_not_taken_for_it(gone):
    right, left = ([seen(one * (sign, 1, 1), side)] for sign, side in ((1, RIGHT), (-1, LEFT)) for one in JOINTS_M[:1])
    frames = 60 * [right] + gone * [[]] + 30 * [left] + gone * [[]] + 60 * [right]
    found = hands_over_time(frames, FPS)
    away = 2 * gone + 30
    assert {side: labels(hand) for side, hand in found.items()} == {
        RIGHT: 60 * "r" + away * "-" + 60 * "r",
        LEFT: (60 + gone) * "-" + 30 * "l" + (gone + 60) * "-",
    }


def test_labels_that_are_wrong_after_a_pause_do_not_cut_a_hand_in_two():
    """Now and then, and in the last frames of all, too few to be a hand."""
    called = [LEFT if k in (9, 20, 21, 38, 39) else RIGHT for k in range(40)]
    frames = [
        [seen(joints, label)] if k not in (8, 19, 37) else []
        for k, (joints, label) in enumerate(zip(JOINTS_M, called, strict=True))
    ]
    assert labels(hands_over_time(frames, FPS)[RIGHT]) == "".join(
        "-" if not one else one[0].handedness[0] for one in frames
    )


def test_a_hand_that_is_there_for_seconds_counts_however_long_the_film_is():
    joints = right_joints_m(70)
    frames = [[seen(one, RIGHT)] for one in joints] + [[]] * 5000
    assert hands_over_time(frames, FPS)[RIGHT].seen.sum() == 70


def test_what_is_left_out_is_known():
    frames = [[seen(JOINTS_M[0], RIGHT)]] * 2 + [[]] * 100
    found = module.hands_over_time(frames, FPS)
    assert found.hands == {}
    assert found.doubted[RIGHT].seen.sum() == 2


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
