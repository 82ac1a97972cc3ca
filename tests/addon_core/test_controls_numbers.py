"""Finger controls mean the same on both hands: a positive turn curls, and spreads away from the middle finger."""

import numpy as np
import pytest

from blender_addon.core import controls, posing
from blender_addon.core import controls as control_numbers
from blender_addon.core.joints import HANDEDNESSES, NAMES, RIGHT


def rest_of(handedness: str) -> np.ndarray:
    return posing.rest_matrices(posing.rest_joints_m(handedness), handedness)


def test_a_full_curl_bends_to_the_angles_of_a_fist_from_straight():
    rest = rest_of(RIGHT)
    bent = controls.rest_flexions(rest)
    for finger in range(1, 5):
        curl = [move.flexion for move in controls.finger_moves(rest, finger, RIGHT)]
        np.testing.assert_allclose(np.degrees(bent[finger] + curl), control_numbers.CURL_DEG[1])
    assert [round(np.degrees(move.flexion)) for move in controls.finger_moves(rest, 0, RIGHT)] == [16, 44, 44]


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
