"""Degenerate hands have exact joints, finite gradients, and a flag that says what is wrong; the kernels agree."""

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands

from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import FrameFlag, Skeleton, swing_pole
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.study.stability_hands import GRADIENT_MAX, beside, hand_cases, template_joints_m

CANONICAL = template_joints_m()
CANONICAL_M = CANONICAL.numpy()
SWINGS = ("minimal", "euler")
LINES = ("palm collapsed to a line", "all joints on a line")
POINTS = ("all knuckles at the wrist", "all joints at one point")
# without a size there is none that gradients could be bounded by
SIZELESS = "all joints at one point"
every_case = pytest.mark.parametrize("case", hand_cases().values(), ids=hand_cases())


@pytest.mark.parametrize("swing", SWINGS)
@every_case
def test_values_and_gradients_are_finite_and_joints_exact(case, swing):
    transform = JointTransform(CANONICAL_M, handedness=case.handedness, swing=swing)
    for dtype in (torch.float32, torch.float64):
        x = beside(case, 20).to(dtype).requires_grad_()
        bones = transform.bones(x)
        frames = bones.frames
        loss = bones.linear.sum() + frames.angles.sum() + frames.palm_p.sum() + frames.palm_n.sum() + bones.scale.sum()
        (gradient,) = torch.autograd.grad(loss, x)
        matrices = bones.matrices().detach()
        for tensor in (matrices, gradient, loss, bones.offset_m):
            assert torch.isfinite(tensor).all()
        if "origin" in case.name:
            continue
        error = hands.joint_error_mm(matrices, CANONICAL, x.detach()) / 1e3 / case.size_m
        # METHOD 2.11
        assert error < (1e-5 if dtype is torch.float32 else 1e-14)
        if dtype is torch.float32 and not case.name.startswith("units") and case.name != SIZELESS:
            assert gradient.abs().max() * case.size_m < GRADIENT_MAX


def test_a_scale_mode_between_has_finite_gradients_on_every_hard_hand():
    for case in hand_cases().values():
        x = case.joints_m[None].clone().requires_grad_()
        bones = JointTransform(CANONICAL_M, handedness=case.handedness, scale_mode=0.3).bones(x)
        (gradient,) = torch.autograd.grad(bones.matrices().sum(), x)
        assert torch.isfinite(bones.linear).all(), case.name
        assert torch.isfinite(gradient).all(), case.name


@pytest.mark.parametrize(
    ("name", "minimal", "euler"),
    [
        ("ordinary: relaxed", 0, 0),
        ("all fingers straight", 0, 0),
        ("left hand", 0, 0),
        ("index folded back at its knuckle", 0, 0),
        ("middle finger sideways, +90 degrees", 0, FrameFlag.SWING_POLE),
        ("middle finger sideways, 90 degrees less 1e-6", 0, FrameFlag.SWING_POLE),
        ("two palm bones in line", FrameFlag.PALM_CLAMPED, FrameFlag.PALM_CLAMPED),
        ("two knuckles crossed", FrameFlag.PALM_CLAMPED, FrameFlag.PALM_CLAMPED),
        ("a bone without length", FrameFlag.ZERO_BONE, FrameFlag.ZERO_BONE),
        ("a finger tip without length", FrameFlag.ZERO_BONE, FrameFlag.ZERO_BONE),
        ("a knuckle at the wrist", FrameFlag.ZERO_BONE, FrameFlag.ZERO_BONE),
        *((name, *[FrameFlag.PALM_CLAMPED | FrameFlag.NO_PALM] * 2) for name in LINES),
        *((name, *[FrameFlag.ZERO_BONE | FrameFlag.NO_PALM] * 2) for name in POINTS),
    ],
)
def test_flags_say_what_is_degenerate(name, minimal, euler):
    case = hand_cases()[name]
    for swing, flags in (("minimal", minimal), ("euler", euler)):
        transform = JointTransform(CANONICAL_M, handedness=case.handedness, swing=swing)
        assert int(transform.frames(case.joints_m).flags) == flags


def test_bones_folded_through_their_canonical_direction_have_frames_that_noise_turns_little():
    joints = CANONICAL.clone()
    for k in range(3):
        # bones 7, 12, 17 turned round: the antipode of the minimal swing
        joints[7 + 5 * k] = (joints[2] if k == 0 else joints[2 + 5 * k]) - (CANONICAL[7] - CANONICAL[2])
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT)
    frames = transform.frames(joints)
    assert int(frames.flags) == 0
    assert (frames.S.transpose(-1, -2) @ frames.S - torch.eye(3)).abs().max() < 1e-12
    noise = 1e-5 * torch.randn(100, 21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert (transform.frames(joints + noise).S - frames.S).abs().max() < 5e-3


def test_a_bone_turned_backwards_and_sideways_is_flagged_and_a_rotation():
    joints = CANONICAL.clone()
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT)
    pole_y, pole_z = swing_pole()
    frames = transform.frames(CANONICAL)
    # the canonical frame of bone 7 is where its smallest rotation starts from
    joints[7] = joints[2] + 0.04 * (frames.S[6] @ torch.tensor([0.0, pole_y, pole_z], dtype=torch.float64))
    frames = transform.frames(joints)
    assert int(frames.flags) & FrameFlag.SWING_POLE
    assert (frames.S.transpose(-1, -2) @ frames.S - torch.eye(3)).abs().max() < 1e-12


@pytest.mark.parametrize("swing", SWINGS)
def test_a_finger_folded_back_has_the_same_angles_in_every_precision(swing):
    joints = hand_cases()["index folded back at its knuckle"].joints_m
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT, swing=swing)
    exact = transform.frames(joints).angles
    assert abs(abs(exact[1, 0]) - np.pi) < 0.3
    assert (transform.frames(joints.float()).angles - exact).abs().max() < 1e-4
    noise = 1e-9 * torch.randn(50, 21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert (transform.frames(joints + noise).angles - exact).abs().max() < 1e-6


@pytest.mark.parametrize("name", ["all fingers straight", "index exactly straight"])
def test_small_noise_on_straight_fingers_turns_the_frames_little(name):
    joints = hand_cases()[name].joints_m
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT)
    noise = 1e-5 * torch.randn(100, 21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    before, after = transform.frames(joints).S, transform.frames(joints + noise).S
    # 0.01 mm on a 20 mm bone is 5e-4 rad; a frame from the cross product of two phalanges would turn by anything
    assert (after - before).abs().max() < 5e-3


@pytest.mark.parametrize("mode", ["axial", "uniform"])
@pytest.mark.parametrize("swing", SWINGS)
@every_case
def test_native_transform_agrees(case, swing, mode):
    joints = case.joints_m
    options = {"handedness": case.handedness, "swing": swing, "scale_mode": mode}
    bones = JointTransform(CANONICAL_M, **options).bones(joints)
    wanted = torch.cat([bones.linear, bones.offset_m.unsqueeze(-1)], -1).numpy()
    found = Skeleton(CANONICAL_M, **options).bones(joints.numpy(), np.float64)
    # worst observed 1.2e-14, beside the abduction pole
    assert np.abs(found.linear_offset - wanted).max() <= 1e-13 * np.abs(wanted).max()
    assert abs(found.scale - float(bones.scale)) <= 1e-14 * found.scale
    assert found.flags == int(bones.frames.flags)
    assert np.array_equal(found.root_m, joints[0].numpy())
    frames = bones.frames
    angles = torch.cat([frames.angles.flatten(), frames.palm_p, frames.palm_n]).numpy()
    # worst observed 1.2e-14, beside the abduction pole
    assert np.abs(found.angles_rad - angles).max() < 2e-14


@pytest.mark.parametrize("swing", SWINGS)
@every_case
def test_every_bone_lies_in_its_parents_frame_as_its_angles_say(case, swing):
    joints = case.joints_m
    transform = JointTransform(CANONICAL_M, handedness=case.handedness, swing=swing)
    frames = transform.frames(joints)
    carried = (frames.S[:15] @ frames.u.unsqueeze(-1)).squeeze(-1)
    # worst observed 4e-16
    assert (carried - frames.direction[5:]).abs().max() < 1e-14
    wanted = hands.mirrored(joints) if case.name == "left hand" else joints
    bones = wanted[1:] - wanted[hands.STARTS[1:]]
    assert (frames.length.unsqueeze(-1) * frames.direction - bones).abs().max() < 1e-14 * joints.abs().max()


@pytest.mark.parametrize("mode", ["axial", "uniform"])
@every_case
def test_frames_of_the_kernels_bones_are_rotations_and_where_a_bone_has_a_length_those_of_the_reference(case, mode):
    joints = case.joints_m
    options = {"handedness": case.handedness, "scale_mode": mode}
    skeleton = Skeleton(CANONICAL_M, **options)
    frames, scales = skeleton.frames(skeleton.bones(joints.numpy(), np.float64))
    # worst observed 4e-14, beside the abduction pole
    assert np.abs(np.swapaxes(frames, -1, -2) @ frames - np.eye(3)).max() < 1e-12
    wanted = JointTransform(CANONICAL_M, **options).frames(joints)
    thick = (scales > 0).all(axis=1)
    reference = torch.cat([wanted.S0.unsqueeze(0), wanted.S]).numpy()
    assert np.abs(frames - reference)[thick].max(initial=0.0) < 1e-12
    np.testing.assert_allclose(scales[1:, 2], wanted.length.numpy() / skeleton.canonical.length_m, 1e-13, 1e-15)
