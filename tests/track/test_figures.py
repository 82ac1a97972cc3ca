"""How far off, how jittery and how late a motion is, by motions of which that is known."""

import numpy as np
import pytest
from tracking_samples import CANONICAL_M, FPS, moving_poses

from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.track.figures import (
    FINGER_BONES,
    angles_between_deg,
    directions_in_palm,
    jitter_deg,
    lag_ms,
)
from jghand_engine.track.skeleton import Skeleton

SKELETON = Skeleton.of(CANONICAL_M)


def directions_at(later_frames, count=60):
    """(F, 20, 3) of a motion that is so many frames late."""
    fine = 20
    joints = moving_poses(fine * (count + 10), fine * FPS).joints_m(SKELETON)
    frames = fine * (np.arange(count) + 5 - later_frames)
    return directions_in_palm(joints[frames.round().astype(int)], CANONICAL_M)


@pytest.mark.parametrize("late", [-2.0, -1.5, -0.3, 0.0, 0.3, 1.5, 2.0])
def test_a_motion_that_is_late_is_late_by_that(late):
    # worst seen 0.34 ms: between frames directions are taken to go straight, and shifts are whole milliseconds
    assert abs(lag_ms(directions_at(late), directions_at(0.0), FPS) - 1000 * late / FPS) < 0.5


def test_of_a_few_frames_no_lag_is_known():
    assert np.isnan(lag_ms(directions_at(0.0, 3), directions_at(0.0, 3), FPS))
    assert abs(lag_ms(directions_at(0.0, 9), directions_at(0.0, 9), FPS)) <= 1


def test_a_bone_that_swings_to_and_fro_has_that_jitter():
    """Three degrees to either side in turn: six from the middle of where it was and will be."""
    canonical = np.broadcast_to(bone_directions(CANONICAL_M[None]), (9, 20, 3))
    side = np.radians(3.0) * (-1.0) ** np.arange(9)
    across = np.cross(canonical[0], (0.3, 0.5, 0.8))
    across /= np.linalg.norm(across, axis=-1, keepdims=True)
    turn = vector_rotation(side[:, None, None] * across)
    swinging = np.einsum("fbij,fbj->fbi", turn, canonical)
    joints = rebuilt(np.zeros((9, 3)), swinging, np.full(20, 0.03))
    assert abs(jitter_deg(joints) - 6.0) < 1e-9
    assert jitter_deg(np.broadcast_to(CANONICAL_M, (9, 21, 3))) == 0.0
    assert np.isnan(jitter_deg(joints[:2]))


def test_a_hand_that_turns_as_a_whole_points_the_same_in_its_palm():
    joints = moving_poses(5).joints_m(SKELETON)
    turned = joints @ vector_rotation(np.array([0.4, -1.2, 0.7])).T
    first, second = (directions_in_palm(one, CANONICAL_M) for one in (joints, turned))
    assert angles_between_deg(first, second).max() < 1e-6


def test_fingers_that_bend_point_elsewhere_in_the_palm_by_that_angle():
    angle = np.zeros((1, 20))
    straight = directions_in_palm(SKELETON.joints(angle), CANONICAL_M)
    angle[0, 4] = np.radians(30.0)  # the index finger's first joint
    bent = directions_in_palm(SKELETON.joints(angle), CANONICAL_M)
    expected = np.zeros((3, 5))
    expected[:, 1] = 30.0
    # the other bones are not quite across the axis; worst seen 0.021
    np.testing.assert_allclose(angles_between_deg(bent, straight)[0, FINGER_BONES].reshape(3, 5), expected, atol=0.025)
