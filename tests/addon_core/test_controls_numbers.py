"""Finger controls mean the same on both hands: a positive turn curls, and spreads away from the middle finger."""

import numpy as np
import pytest

from blender_addon.core import controls, posing
from blender_addon.core.joints import HANDEDNESSES, NAMES


def rest_of(handedness: str) -> np.ndarray:
    return posing.rest_matrices(posing.rest_joints_m(handedness), handedness)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_the_rest_pose_and_a_full_spread_lie_within_the_ranges(handedness):
    ranges = {span.bone: span for span in controls.joint_ranges(rest_of(handedness), handedness)}
    assert set(ranges) == {NAMES[place] for place in range(1, 21) if place % 4}
    assert all(low <= 0 <= high for span in ranges.values() for low, high in (span.x, span.y, span.z))
    for finger in range(5):
        span = ranges[controls.moving_bones(finger)[0]]
        low, high = np.degrees(span.z)
        assert low <= controls.spread_sign(finger, handedness) * controls.SPREAD_FULL_DEG <= high
