"""The 21 bone transforms of batches of ordinary hands. Degenerate ones are in tests/hard_cases."""

from functools import cache

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands
from hypothesis import given, settings
from hypothesis import strategies as st

from jghand_engine.avatar.avatar import FOREARM_WAY
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.skeleton import FrameFlag, Skeleton
from jghand_engine.learn.skeleton import JointTransform

CANONICAL = hands.canonical()
CANONICAL_M = hands.canonical_np()
MODES = [(swing, mode) for swing in ("minimal", "euler") for mode in ("uniform", "axial", 0.3)]


@cache
def many_hands():
    return hands.sample(10_000)


@pytest.mark.parametrize(("swing", "mode"), MODES)
# METHOD 2.11; worst observed over 100,000 hands 1.8e-4 and 3.4e-13, over as many clouds 4.5e-4 and 1.3e-12
@pytest.mark.parametrize(("dtype", "limit_mm"), [(torch.float32, 5e-4), (torch.float64, 2e-12)])
def test_both_ends_of_every_bone_land_on_the_joints(swing, mode, dtype, limit_mm):
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT, swing=swing, scale_mode=mode)
    cloud = 0.05 * torch.randn(5000, 21, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    for joints in (many_hands(), cloud):
        joints = joints.to(dtype)
        assert hands.joint_error_mm(transform.bones(joints).matrices(), CANONICAL, joints) < limit_mm


def test_root_relative_form_is_more_exact_far_from_the_origin():
    joints = hands.sample(500).float()
    bones = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).bones(joints)
    centered = CANONICAL.float() - bones.canonical_root_m
    placed = (bones.linear * centered.unsqueeze(-2)).sum(-1) + bones.offset_m + bones.root_m.unsqueeze(-2)
    # worst observed 6.7e-5 mm
    assert ((placed - joints).norm(dim=-1).max() * 1e3) < 1.5e-4


@pytest.mark.parametrize("handedness", list(Handedness))
def test_offsets_are_the_matrices_own_rounded_once(handedness):
    """In single precision: what a matrix has lost its offset makes good, so that joints lose nothing twice."""
    joints = hands.sample(500, shift_m=0.0).float()
    joints = joints - joints[:, :1]
    bones = JointTransform(CANONICAL_M, handedness=handedness).bones(joints)
    starts = hands.STARTS
    carried = (bones.linear.double() * (CANONICAL - CANONICAL[0])[starts].float().double().unsqueeze(-2)).sum(-1)
    wanted = joints[:, starts].double() - carried
    # half a unit in the last place of a float32
    assert ((bones.offset_m - wanted).abs() <= 2.0**-24 * wanted.abs() * (1 + 1e-6)).all()


def test_canonical_hand_maps_to_itself():
    matrices = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).bones(CANONICAL).matrices()
    identity = torch.eye(3, 4, dtype=torch.float64)
    # worst observed 1.2e-15
    assert (matrices - identity).abs().max() < 1e-14


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_left_hand_is_exactly_the_mirrored_right(dtype):
    joints = hands.sample(300, seed=9).to(dtype)
    right = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).bones(joints).matrices()
    left = JointTransform(CANONICAL_M, handedness=Handedness.LEFT).bones(hands.mirrored(joints)).matrices()
    mirror = torch.tensor([-1.0, 1.0, 1.0], dtype=dtype).reshape(3, 1)
    assert torch.equal(mirror * right, left)


def test_moving_turning_and_scaling_the_hand_carries_the_matrices_along():
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT)
    joints = hands.sample(300, seed=2)
    matrices = transform.bones(joints).matrices()
    R = hands.random_rotations(300, torch.Generator().manual_seed(0))
    shift = torch.randn(300, 1, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    moved = transform.bones(joints @ R.transpose(-1, -2) + shift).matrices()
    expected = R[:, None] @ matrices
    expected[..., 3] += shift
    # worst observed 5.4e-14 and 1.7e-13
    assert (moved - expected).abs().max() < 1e-12
    assert (transform.bones(joints * 7.5).matrices() - 7.5 * matrices).abs().max() < 1e-12


def test_frames_are_rotations_along_their_bones():
    frames = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).frames(hands.sample(300, palm_m=0.002))
    S = torch.cat([frames.S, frames.S0.unsqueeze(-3)], -3)
    assert (S.transpose(-1, -2) @ S - torch.eye(3)).abs().max() < 1e-12
    assert (torch.linalg.det(S) > 0).all()
    assert (frames.S[..., 2] - frames.direction).abs().max() < 1e-12
    assert (frames.flags == 0).all()


def test_flexion_is_positive_towards_the_palm_and_x_points_out_of_it():
    fist = hands.hand(torch.full((1, 5, 3), 0.8, dtype=torch.float64), torch.zeros(1, 5, dtype=torch.float64))
    frames = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).frames(fist)
    assert (frames.angles[0, 1:5, 0] > 0.7).all()
    # the palm looks along -z in the sampled hands
    assert frames.S0[0, 2, 0] < -0.9


def test_angles_rebuild_the_local_directions():
    frames = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT, swing="euler").frames(hands.sample(300))
    flexion, abduction = frames.angles.unbind(-1)
    u = torch.stack([flexion.sin() * abduction.cos(), -abduction.sin(), flexion.cos() * abduction.cos()], -1)
    assert (u - frames.u).abs().max() < 1e-12


def test_scale_modes_set_thickness_and_never_length():
    joints = hands.sample(200)
    along = {}
    for mode in ("axial", "uniform", 0.5):
        bones = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT, scale_mode=mode).bones(joints)
        # thickness: how far a unit step across the canonical bone becomes
        rest = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).frames(CANONICAL)
        across = (bones.linear[:, 1:] * rest.S[..., 0].unsqueeze(-2)).sum(-1).norm(dim=-1)
        along[mode] = (bones.linear[:, 1:] * rest.direction.unsqueeze(-2)).sum(-1).norm(dim=-1)
        s = bones.frames.length / rest.length
        s_g = bones.scale.unsqueeze(-1)
        expected = {"axial": s_g.expand_as(s), "uniform": s, 0.5: s_g * (s / s_g) ** 0.5}[mode]
        assert (across - expected).abs().max() < 1e-12
    assert (along["axial"] - along["uniform"]).abs().max() < 1e-12


def test_batch_shapes_are_kept():
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT)
    joints = hands.sample(6)
    flat, grid = transform.bones(joints), transform.bones(joints.reshape(2, 3, 21, 3))
    assert grid.linear.shape == (2, 3, 21, 3, 3)
    assert grid.matrices().shape == (2, 3, 21, 3, 4)
    assert grid.scale.shape == grid.frames.flags.shape == (2, 3)
    assert grid.frames.palm_p.shape == (2, 3, 4)
    assert grid.frames.palm_n.shape == (2, 3, 3)
    assert torch.equal(grid.matrices().reshape(6, 21, 3, 4), flat.matrices())
    single = transform.bones(joints[0])
    assert single.linear.shape == (21, 3, 3)
    assert single.scale.shape == ()
    assert (single.matrices() - flat.matrices()[0]).abs().max() < 1e-14
    assert transform.bones(joints[:0]).matrices().shape == (0, 21, 3, 4)


@pytest.mark.parametrize("bad", [float("nan"), float("inf")])
def test_a_bad_joint_spoils_only_its_own_hand(bad):
    transform = JointTransform(CANONICAL_M, handedness=Handedness.RIGHT)
    joints = hands.sample(3)
    good = transform.bones(joints)
    for joint in range(21):
        spoiled = joints.clone()
        spoiled[1, joint, 1] = bad
        bones = transform.bones(spoiled)
        assert torch.isnan(bones.linear[1]).all()
        assert int(bones.frames.flags[1]) == FrameFlag.NOT_FINITE
        assert torch.equal(bones.matrices()[[0, 2]], good.matrices()[[0, 2]])


@pytest.mark.parametrize(
    ("swing", "mode", "pose"),
    [
        *((*mode, "generic") for mode in MODES),
        *((*mode, pose) for mode in (MODES[1], MODES[5]) for pose in ("straight", "collinear", "millimeters", "left")),
    ],
)
def test_gradients_are_the_derivatives(swing, mode, pose):
    joints = hands.sample(1, seed=3, palm_m=0.003, bone=0.1, shift_m=0.0, turned=False)[0]
    unit = 1000.0 if pose == "millimeters" else 1.0
    if pose == "straight":
        joints = hands.flat()
    if pose == "collinear":
        along = joints[2] / joints[2].norm()
        for k, length in enumerate((0.04, 0.07, 0.09)):
            joints[7 + 5 * k] = joints[2] + along * length
    handedness = Handedness.LEFT if pose == "left" else Handedness.RIGHT
    transform = JointTransform(CANONICAL_M, handedness=handedness, swing=swing, scale_mode=mode)
    # a fixed random mixture of all entries: fewer backward passes, nothing cancels
    mix = torch.randn(21 * 12, 12, dtype=torch.float64, generator=torch.Generator().manual_seed(0)) / 16

    def outputs(x):
        bones = transform.bones(x)
        frames = bones.frames
        return bones.matrices().reshape(1, -1) @ mix, frames.angles, frames.palm_p, frames.palm_n, bones.scale

    x = (joints * unit).unsqueeze(0).clone().requires_grad_()
    assert torch.autograd.gradcheck(outputs, (x,), eps=1e-8 * unit, atol=2e-5, rtol=1e-4)


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**31),
    bone=st.floats(0.0, 0.6),
    scale=st.floats(1e-3, 1e3),
    exponent=st.floats(0.0, 1.0),
    swing=st.sampled_from(["minimal", "euler"]),
    handedness=st.sampled_from(list(Handedness)),
)
def test_joints_are_exact_for_any_hand(seed, bone, scale, exponent, swing, handedness):
    transform = JointTransform(CANONICAL_M, handedness=handedness, swing=swing, scale_mode=exponent)
    joints = scale * hands.sample(4, seed=seed, bone=bone, shift_m=0.1)
    # 2e-12 mm for hands of ordinary size, METHOD 2.11; round-off grows with the size
    limit = 2e-12 * max(1.0, scale)
    assert hands.joint_error_mm(transform.bones(joints).matrices(), CANONICAL, joints) < limit


@pytest.mark.parametrize("handedness", list(Handedness))
def test_slices_of_a_turned_forearm_differ_from_the_palm_as_the_kernels_do(handedness):
    options = {"handedness": handedness, "forearm_way": FOREARM_WAY}
    joints, turn = hands.sample(1, seed=7)[0], np.array([0.9, 0.3, -0.2, 0.25])
    ours = JointTransform(CANONICAL_M, **options).bones(joints, turn)
    wanted = Skeleton(CANONICAL_M, **options).bones(joints.numpy(), np.float64, forearm=turn).linear_offset
    found = torch.cat([ours.linear, ours.offset_m[..., None]], -1).numpy()
    # worst observed 2e-15
    np.testing.assert_allclose(found, wanted, atol=1e-13)
    assert np.abs(found[21:]).max() > 0.3
    bare = JointTransform(CANONICAL_M, handedness=handedness)
    assert (
        len(bare.bones(joints, turn).linear) == len(JointTransform(CANONICAL_M, **options).bones(joints).linear) == 21
    )


def test_unusable_arguments_are_named():
    with pytest.raises(InputError, match="scale mode"):
        JointTransform(CANONICAL_M, handedness=Handedness.RIGHT, scale_mode=1.5)
    with pytest.raises(InputError, match="swing"):
        JointTransform(CANONICAL_M, handedness=Handedness.RIGHT, swing="roll")
    with pytest.raises(InputError, match="two hands of InterHand"):
        JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).bones(torch.zeros(42, 3))
    with pytest.raises(InputError, match="floating point"):
        JointTransform(CANONICAL_M, handedness=Handedness.RIGHT).bones(torch.zeros(21, 3, dtype=torch.int64))
