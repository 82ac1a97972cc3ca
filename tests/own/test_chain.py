"""The bones of a hand whose lengths are sought."""

import numpy as np
import torch
from tracking_samples import CANONICAL_M, moving_poses

from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.own.chain import Chain, rotation
from jghand_engine.track.poses import JointChain

NONE = torch.zeros(20, dtype=torch.float64), torch.zeros(5, 3, dtype=torch.float64)


def test_it_is_the_chain_of_the_tracker():
    angle = moving_poses(9).angle_rad
    ours = Chain.of(CANONICAL_M, dtype=torch.float64).joints(torch.from_numpy(angle), *NONE)
    np.testing.assert_allclose(ours.numpy(), JointChain.of(CANONICAL_M).joints(angle), atol=1e-15)


def test_bones_have_the_lengths_asked_for_and_the_hand_keeps_its_own():
    change = torch.from_numpy(np.random.default_rng(1).normal(0, 0.06, 20))
    joints = Chain.of(CANONICAL_M, 0.2, torch.float64).joints(torch.zeros(1, 20).double(), change, NONE[1])[0].numpy()
    assert abs(hand_length(joints) - 0.2) < 1e-15
    ratio = bone_lengths(joints) / bone_lengths(CANONICAL_M) / np.exp(change.numpy())
    assert np.ptp(ratio) < 1e-14


def test_rotations_are_exact_and_differentiable_at_nothing():
    vectors = np.array([[0, 0, 0], [1e-9, 0, 0], [0.3, -0.2, 0.9], [0, 3.1, 0.2]])
    np.testing.assert_allclose(rotation(torch.from_numpy(vectors)).numpy(), vector_rotation(vectors), atol=1e-15)
    assert torch.autograd.gradcheck(rotation, torch.from_numpy(vectors[:1]).requires_grad_())
