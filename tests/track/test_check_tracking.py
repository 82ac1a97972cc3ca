"""What scripts/check_tracking.py measures, on a motion that a perfect detector sees."""

import check_tracking
import numpy as np
import pytest
from tracking_samples import CANONICAL_M, FPS, moving_poses, right_joints_m, sight

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.track.poses import JointChain
from jghand_engine.track.track import MOTION_FROM_CAMERA, angles_between_deg

CHAIN = JointChain.of(CANONICAL_M)


@pytest.fixture(scope="module")
def truth():
    return check_tracking.Truth("waving", right_joints_m(40) * MOTION_FROM_CAMERA, Handedness.RIGHT)


def test_every_method_of_a_perfect_detector_is_near_the_truth(truth):
    rows = {
        row.method: row
        for row in check_tracking.rows_of_sightings(truth, sight(right_joints_m(40)).sightings, CANONICAL_M)
    }
    assert rows["the truth itself"].in_space == (0.0, 0.0)
    assert rows["detector alone"].in_space[1] < 1e-9
    assert rows["**jghand track**"].in_space[0] < 0.7, "seen: 0.62 degrees: fingers are hardly spread by its prior"
    assert abs(rows["**jghand track**"].lag_ms) < 2.5
    assert rows["detector, one-euro filter"].lag_ms > 60, "a filter that lags is seen to lag; seen: 69 ms"
    assert all(row.seen == "40 of 40" for row in rows.values())


def test_a_hand_that_is_not_found_has_no_figures(truth):
    (row,) = check_tracking.rows_of_sightings(truth, sight(np.zeros((0, 21, 3))).sightings, CANONICAL_M)
    assert row.cells()[2:] == ["0 of 40", *["-"] * 6]


def directions_at(later_frames, count=60):
    """(F, 20, 3) of a motion that is so many frames late."""
    fine = 20
    joints = moving_poses(fine * (count + 10), fine * FPS).joints_m(CHAIN)
    frames = fine * (np.arange(count) + 5 - later_frames)
    return check_tracking.directions_in_palm(joints[frames.round().astype(int)], CANONICAL_M)


@pytest.mark.parametrize("late", [-2.0, -1.5, -0.3, 0.0, 0.3, 1.5, 2.0])
def test_a_motion_that_is_late_is_late_by_that(late):
    # worst seen 0.34 ms: between frames directions are taken to go straight, and shifts are whole milliseconds
    assert abs(check_tracking.lag_ms(directions_at(late), directions_at(0.0), FPS) - 1000 * late / FPS) < 0.5


def test_a_hand_that_turns_as_a_whole_points_the_same_in_its_palm():
    joints = moving_poses(5).joints_m(CHAIN)
    turned = joints @ vector_rotation(np.array([0.4, -1.2, 0.7])).T
    first, second = (check_tracking.directions_in_palm(one, CANONICAL_M) for one in (joints, turned))
    assert angles_between_deg(first, second).max() < 1e-6
