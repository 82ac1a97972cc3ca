"""Joint angles and back, and interpolation between poses."""

from dataclasses import replace

import pytest
import torch
from hand import sampled_hands as hands
from hypothesis import given, settings
from hypothesis import strategies as st

from jghand_engine.errors import InputError
from jghand_engine.hand import rotations as rot
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import decompose, forward_kinematics, interpolate
from jghand_engine.hand.transform import JointTransform

CANONICAL = hands.canonical()
SIDES = [(swing, side) for swing in ("minimal", "euler") for side in Handedness]


def _pair(side, seed=0, n=100):
    a, b = hands.sample(n, seed=seed), hands.sample(n, seed=seed + 1000)
    return (a, b) if side is Handedness.RIGHT else (hands.mirrored(a), hands.mirrored(b))


@pytest.mark.parametrize(("swing", "side"), SIDES)
def test_angles_give_the_joints_back(swing, side):
    transform = JointTransform(CANONICAL, handedness=side, swing=swing)
    joints, _ = _pair(side, n=1000)
    # METHOD 6.3 asks for 1e-6 m; worst observed 4e-16
    assert (forward_kinematics(transform, decompose(transform, joints)) - joints).abs().max() < 1e-14


@pytest.mark.parametrize(("swing", "side"), SIDES)
def test_interpolation_ends_at_the_given_poses(swing, side):
    transform = JointTransform(CANONICAL, handedness=side, swing=swing)
    a, b = _pair(side)
    between = interpolate(transform, a, b, torch.linspace(0, 1, 5))
    assert between.shape == (5, 100, 21, 3)
    # METHOD 6.3 asks for 1e-6 m; worst observed 6e-16
    assert (between[0] - a).abs().max() < 1e-14
    assert (between[-1] - b).abs().max() < 1e-14


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**20), part=st.floats(0, 1), swing=st.sampled_from(["minimal", "euler"]))
def test_bone_lengths_go_linearly_and_bones_never_shrink_between(seed, part, swing):
    transform = JointTransform(CANONICAL, handedness=Handedness.RIGHT, swing=swing)
    a, b = _pair(Handedness.RIGHT, seed, n=8)
    middle = interpolate(transform, a, b, torch.tensor([part], dtype=torch.float64))[0]
    lengths = [(x[:, 1:] - x[:, hands.STARTS[1:]]).norm(dim=-1) for x in (a, b, middle)]
    assert (lengths[2] - ((1 - part) * lengths[0] + part * lengths[1])).abs().max() < 1e-14


def test_half_way_between_straight_and_bent_is_half_bent():
    transform = JointTransform(CANONICAL, handedness=Handedness.RIGHT)
    straight = decompose(transform, hands.flat())

    def bent(by_rad):
        angles = straight.angles.clone()
        # the PIP joints of index to pinky
        angles[6:10, 0] += by_rad
        return forward_kinematics(transform, replace(straight, angles=angles))

    middle = interpolate(transform, hands.flat(), bent(1.2), torch.tensor([0.5]))[0]
    assert (middle - bent(0.6)).abs().max() < 1e-12


def test_angles_go_the_short_way_round():
    transform = JointTransform(CANONICAL, handedness=Handedness.RIGHT)
    rest = decompose(transform, hands.flat())

    def index_bent_to(angle_rad):
        angles = rest.angles.clone()
        angles[6, 0] = angle_rad
        return forward_kinematics(transform, replace(rest, angles=angles))

    # 3.0 and -3.0 rad are 0.28 apart, by way of pi
    middle = interpolate(transform, index_bent_to(3.0), index_bent_to(-3.0), torch.tensor([0.5]))[0]
    assert (middle - index_bent_to(torch.pi)).abs().max() < 1e-12


def test_palm_turns_the_short_way():
    joints = hands.canonical()
    R = hands.random_rotations(20, torch.Generator().manual_seed(0))
    turned = joints @ R.transpose(-1, -2)
    path = interpolate(
        JointTransform(CANONICAL, handedness=Handedness.RIGHT),
        joints.expand(20, 21, 3),
        turned,
        torch.linspace(0, 1, 9),
    )
    frames = JointTransform(CANONICAL, handedness=Handedness.RIGHT).frames(path).S0
    relative = frames[:-1].transpose(-1, -2) @ frames[1:]
    step = torch.arccos(((relative.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2).clamp(-1, 1))
    whole = torch.arccos((R.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2)
    assert (step - whole / 8).abs().max() < 1e-7
    # a hand that only turns keeps its shape
    inside = decompose(JointTransform(CANONICAL, handedness=Handedness.RIGHT), path)
    assert (inside.angles - inside.angles[:1]).abs().max() < 1e-12


def test_forward_kinematics_is_differentiable():
    transform = JointTransform(CANONICAL, handedness=Handedness.RIGHT)
    pose = decompose(transform, hands.sample(1, seed=5)[0])

    def joints(angles, lengths):
        return forward_kinematics(transform, replace(pose, angles=angles, length_m=lengths))

    inputs = (pose.angles.clone().requires_grad_(), pose.length_m.clone().requires_grad_())
    assert torch.autograd.gradcheck(joints, inputs, eps=1e-7, atol=1e-6)


def test_interpolation_between_equal_poses_has_the_gradient_of_a_straight_line():
    transform = JointTransform(CANONICAL, handedness=Handedness.RIGHT)
    joints = hands.sample(6, palm_m=0.0, turned=False)
    first, second = joints.clone().requires_grad_(), joints.clone().requires_grad_()
    weights = torch.randn(3, 6, 21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    parts = torch.tensor([0.0, 0.3, 1.0], dtype=torch.float64)
    (interpolate(transform, first, second, parts) * weights).sum().backward()
    assert first.grad is not None
    assert second.grad is not None
    share = parts.reshape(3, 1, 1, 1)
    # both ends are one pose, so there is no arc yet: observed 2e-15
    assert float((first.grad - ((1 - share) * weights).sum(0)).abs().max()) < 1e-13
    assert float((second.grad - (share * weights).sum(0)).abs().max()) < 1e-13


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_slerp_between_equal_and_opposite_ends_has_finite_gradients(dtype):
    a = torch.tensor([[0.6, 0.0, -0.8]], dtype=dtype).T.requires_grad_()
    for sign in (1.0, -1.0):
        (gradient,) = torch.autograd.grad(rot.slerp(a, sign * a, torch.tensor([0.25], dtype=dtype)).sum(), a)
        assert bool(torch.isfinite(gradient).all())


def test_poses_of_different_shape_are_refused():
    with pytest.raises(InputError, match="second pose"):
        interpolate(
            JointTransform(CANONICAL, handedness=Handedness.RIGHT), hands.sample(2), hands.sample(3), torch.zeros(1)
        )
