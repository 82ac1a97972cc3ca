"""The closed form is the paper's chain once its misprints are corrected."""

import pytest
import torch
from hand import sampled_hands as hands
from learn.factored import MISPRINTS, factored

from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.skeleton import JointTransform

CANONICAL = hands.canonical()


@pytest.mark.parametrize("swing", ["minimal", "euler"])
def test_closed_form_is_the_corrected_chain(swing):
    joints = hands.sample(500)
    transform = JointTransform(CANONICAL.numpy(), handedness=Handedness.RIGHT, swing=swing, scale_mode="uniform")
    shift = torch.eye(4, dtype=torch.float64)
    shift[:3, 3] = -CANONICAL[0]
    chain = factored(transform, CANONICAL, joints) @ shift
    difference = (chain[..., :3, :] - transform.bones(joints).matrices()[:, 1:]).abs().max()
    # worst observed 2.9e-15
    assert difference < 1e-13


@pytest.mark.parametrize("variant", MISPRINTS)
def test_a_misprint_moves_joints_by_centimeters(variant):
    joints = hands.sample(500)
    transform = JointTransform(CANONICAL.numpy(), handedness=Handedness.RIGHT, scale_mode="uniform")
    matrices = factored(transform, CANONICAL, joints, variant)
    ends = (matrices[..., :3, :3] @ (CANONICAL - CANONICAL[0])[1:, :, None]).squeeze(-1) + matrices[..., :3, 3]
    error_m = (ends - joints[:, 1:]).norm(dim=-1)
    # PAPER 1: 3.6 to 13.4 mm on average, 51 to 139 mm at worst
    assert error_m.mean() > 3e-3
    assert error_m.max() > 50e-3
