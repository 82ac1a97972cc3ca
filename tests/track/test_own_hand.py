"""The proportions of the hand that was seen."""

import numpy as np
from tracking_samples import CAMERA, CANONICAL_M, FPS, moving_poses

from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.track.own_hand import own_canonical_joints
from jghand_engine.track.poses import JointChain, Landmarks


def another_hand(sigma=0.08, seed=2):
    factors = np.exp(sigma * np.random.default_rng(seed).standard_normal(20))
    directions = bone_directions(CANONICAL_M[None])
    return rebuilt(np.zeros((1, 3)), directions, bone_lengths(CANONICAL_M) * factors)[0]


def off(joints, truth):
    """How far proportions are off: spread of the bones' ratios."""
    return np.std(np.log(bone_lengths(joints) / bone_lengths(truth)))


def test_the_bones_of_another_hand_are_found_from_its_pictures():
    truth = another_hand()
    joints = moving_poses(60).joints_m(JointChain.of(truth))
    seen = Landmarks(CAMERA.project(joints), bone_directions(joints), CAMERA, FPS)
    own = own_canonical_joints(CANONICAL_M, seen, 0.19)
    assert abs(hand_length(own) - 0.19) < 1e-12
    assert off(own, truth) < 0.6 * off(CANONICAL_M, truth), "seen: 0.48, as it is held to where it starts"


def test_of_the_same_hand_nothing_is_changed():
    joints = moving_poses(60).joints_m(JointChain.of(CANONICAL_M))
    seen = Landmarks(CAMERA.project(joints), bone_directions(joints), CAMERA, FPS)
    own = own_canonical_joints(CANONICAL_M, seen, hand_length(CANONICAL_M))
    # the pull of the poses to rest costs a little; seen: 0.2 %
    assert off(own, CANONICAL_M) < 0.004
