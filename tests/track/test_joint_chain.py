"""A hand of constant bones: its joints, and how they move."""

import numpy as np
from tracking_samples import CANONICAL_M, moving_poses

from jghand_engine.hand.kinematics import ArticulatedHand
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.track.poses import LIMITS_RAD, JointChain

CHAIN = JointChain.of(CANONICAL_M)


def angles(count=5, seed=0):
    part = np.random.default_rng(seed).random((count, 20))
    return LIMITS_RAD[:, 0] + part * np.ptp(LIMITS_RAD, axis=1)


def test_it_is_the_articulated_hand_in_radians():
    angle = angles()
    hand = ArticulatedHand(CANONICAL_M).joints(np.degrees(angle).reshape(-1, 5, 4))
    np.testing.assert_allclose(CHAIN.joints(angle), hand - hand[:, :1], atol=1e-15)


def test_bones_keep_their_lengths_whatever_the_angles():
    lengths = bone_lengths(CHAIN.joints(3 * angles()))
    np.testing.assert_allclose(lengths, np.broadcast_to(CHAIN.bone_lengths_m, lengths.shape), atol=1e-15)


def test_derivatives_are_those_of_finite_differences():
    angle, step = angles(), 1e-6
    moved = [CHAIN.joints(angle + sign * step * np.eye(20)[k]) for k in range(20) for sign in (1, -1)]
    differences = np.stack([(moved[2 * k] - moved[2 * k + 1]) / (2 * step) for k in range(20)], -1)
    # worst seen 2e-11: round-off of the differences
    np.testing.assert_allclose(CHAIN.joints_and_motion(angle)[1], differences, atol=1e-10)


def test_a_turn_by_nothing_is_no_turn():
    np.testing.assert_array_equal(vector_rotation(np.zeros((1, 3)))[0], np.eye(3))


def test_steps_lead_from_each_pose_to_the_next():
    poses = moving_poses(6)
    steps = np.concatenate([np.zeros((1, 26)), poses.steps()])
    there = poses.part(slice(0, 5)).moved(steps[1:])
    np.testing.assert_allclose(there.turn, poses.turn[1:], atol=1e-12)
    np.testing.assert_allclose(there.angle_rad, poses.angle_rad[1:], atol=1e-15)
