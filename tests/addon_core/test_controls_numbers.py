"""Finger controls mean the same on both hands: a positive turn curls, and spreads away from the middle finger."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon.core import controls, posing
from blender_addon.core import controls as control_numbers
from blender_addon.core.joints import FINGERS, HANDEDNESSES, NAMES, PARENTS, RIGHT


def rest_of(handedness: str) -> np.ndarray:
    return posing.rest_matrices(posing.rest_joints_m(handedness), handedness)


def turned_tip(rest: np.ndarray, bone: str, axis: int, angle: float) -> np.ndarray:
    """Where the end of a bone goes when it turns about one of its axes."""
    place = NAMES.index(bone)
    turn = np.eye(3)
    first, second = [(1, 2), (2, 0), (0, 1)][axis]
    turn[first, first] = turn[second, second] = np.cos(angle)
    turn[first, second], turn[second, first] = -np.sin(angle), np.sin(angle)
    head = rest[place, :3, 3]
    along = rest[place, :3, :3].T @ (rest[place + 1, :3, 3] - head)
    return head + rest[place, :3, :3] @ turn @ along


@pytest.mark.parametrize("handedness", HANDEDNESSES)
@pytest.mark.parametrize("finger", range(5), ids=FINGERS)
def test_a_positive_spread_leads_away_from_the_middle_finger(handedness, finger):
    rest = rest_of(handedness)
    move = controls.finger_moves(rest, finger, handedness)[0]
    end = rest[NAMES.index(move.bone) + 1, :3, 3]
    moved = turned_tip(rest, move.bone, 2, move.spread)
    if FINGERS[finger] == "middle":  # to the thumb's side
        to_index = rest[NAMES.index("index1"), :3, 3] - rest[NAMES.index("pinky1"), :3, 3]
        assert (moved - end) @ to_index > 0
    else:
        middle = rest[NAMES.index("middle4"), :3, 3]
        assert np.linalg.norm(moved - middle) > np.linalg.norm(end - middle) + 0.001
    assert abs(move.spread) == pytest.approx(np.radians(control_numbers.SPREAD_FULL_DEG))


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_turns_of_a_control_are_the_turns_of_its_finger_whatever_way_its_axes_point(handedness):
    rest = rest_of(handedness)
    for finger, name in enumerate(controls.FINGER_CONTROLS):
        axes = controls.control_matrices(rest, handedness)[name][:3, :3]
        bone = rest[1 + 4 * finger, :3, :3]
        assert np.linalg.det(axes) == pytest.approx(1)
        np.testing.assert_allclose(axes[:, 0], bone[:, 0], atol=1e-12)
        np.testing.assert_allclose(axes[:, 2], controls.spread_sign(finger, handedness) * bone[:, 2], atol=1e-12)


def test_a_full_curl_bends_to_the_angles_of_a_fist_from_straight():
    rest = rest_of(RIGHT)
    bent = controls.rest_flexions(rest)
    for finger in range(1, 5):
        curl = [move.flexion for move in controls.finger_moves(rest, finger, RIGHT)]
        np.testing.assert_allclose(np.degrees(bent[finger] + curl), control_numbers.CURL_DEG[1])
    assert [round(np.degrees(move.flexion)) for move in controls.finger_moves(rest, 0, RIGHT)] == [16, 44, 44]


def test_flexions_at_rest_are_small_and_forward_as_of_a_relaxed_hand():
    bent = np.degrees(controls.rest_flexions(rest_of(RIGHT)))[1:]
    # the built-in hand: -4.4 (the ring finger's last joint) to 14.2 degrees
    assert bent.min() > -5
    assert bent.max() < 15


def test_both_hands_have_mirrored_numbers():
    right, left = (controls.joint_ranges(rest_of(side), side) for side in HANDEDNESSES)
    for one, other in zip(right, left, strict=True):
        assert one.bone == other.bone
        np.testing.assert_allclose(one.x, other.x, atol=1e-12)
        np.testing.assert_allclose(one.z, (-other.z[1], -other.z[0]), atol=1e-12)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_the_rest_pose_and_a_full_curl_lie_within_the_ranges(handedness):
    rest = rest_of(handedness)
    ranges = {span.bone: span for span in controls.joint_ranges(rest, handedness)}
    assert set(ranges) == {NAMES[place] for place in range(1, 21) if place % 4}
    for finger in range(5):
        for move in controls.hand_moves(rest, finger, handedness):
            span = ranges[move.bone]
            assert span.x[0] <= 0 <= span.x[1]
            assert move.flexion <= span.x[1]
            assert span.z[0] <= move.spread <= span.z[1]


def test_a_splay_moves_the_middle_finger_not_and_the_little_finger_most():
    rest = rest_of(RIGHT)
    spread = [abs(controls.hand_moves(rest, finger, RIGHT)[0].spread) for finger in range(5)]
    assert spread[2] == 0
    assert int(np.argmax(spread)) == 4


def test_controls_have_names_that_no_joint_has():
    assert len(set(controls.CONTROLS)) == 11
    assert not set(controls.CONTROLS) & set(NAMES)
    assert all(PARENTS[NAMES.index(controls.moving_bones(finger)[0])] == 0 for finger in range(5))
