"""The transforms that ours is compared with: right where they claim to be, wrong where they must be."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hand.sampled_hands import canonical, canonical_np, mirrored, random_rotations, sample

from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.hand.kinematics import RANGES_DEG, ArticulatedHand
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.learn.baselines import HaloLikeTransform, NaiveTransform
from jghand_engine.learn.skeleton import JointTransform

STARTS_OF_BONES = list(PARENTS[1:])
BOTH = (HaloLikeTransform, NaiveTransform)


def halo(handedness=Handedness.RIGHT, kind=HaloLikeTransform):
    return kind(canonical_np(), handedness=handedness)


def same_proportions(n=50):
    """Hands with the lengths and the palm of the canonical one, in any pose, turned and moved."""
    low, high = np.moveaxis(RANGES_DEG, -1, 0)
    angles = low + np.random.default_rng(0).random((n, 5, 4)) * (high - low)
    joints = torch.from_numpy(ArticulatedHand(canonical_np()).joints(angles))
    generator = torch.Generator().manual_seed(1)
    return joints @ random_rotations(n, generator).mT + torch.rand(n, 1, 3, generator=generator)


def moved_joints(bones):
    """(N, 21, 3) where each bone's own matrix takes its end."""
    matrices = bones.matrices()
    return (matrices[..., :3] * canonical()[:, None]).sum(-1) + matrices[..., 3]


def test_halo_like_is_our_transform_on_hands_of_canonical_proportions():
    joints = same_proportions()
    ours = JointTransform(canonical_np(), handedness=Handedness.RIGHT, scale_mode="uniform").bones(joints)
    # worst observed 4e-15
    torch.testing.assert_close(halo().bones(joints).matrices(), ours.matrices(), rtol=0, atol=1e-13)


def test_halo_like_keeps_the_canonical_bone_lengths():
    placed = moved_joints(halo().bones(sample(30)))
    length = (placed[:, 1:] - placed[:, STARTS_OF_BONES]).norm(dim=-1)
    wanted = (canonical()[1:] - canonical()[STARTS_OF_BONES]).norm(dim=-1)
    torch.testing.assert_close(length, wanted.expand(30, 20))


def test_halo_like_bones_meet_at_their_joints():
    bones = halo().bones(sample(30))
    matrices = bones.matrices()
    starts = (matrices[:, 6:, :, :3] * canonical()[1:16, None]).sum(-1) + matrices[:, 6:, :, 3]
    torch.testing.assert_close(starts, moved_joints(bones)[:, 1:16])


def test_halo_like_moves_the_palm_as_one_piece():
    linear = halo().bones(sample(5)).linear
    torch.testing.assert_close(linear[:, 1:6], linear[:, :1].expand(5, 5, 3, 3))


def test_halo_like_misses_the_joints_of_longer_fingers():
    """Every finger bone a fifth longer: the tips are missed by about a fifth of three bones."""
    rest_m = canonical_np()[None]
    longer = bone_lengths(rest_m) * np.repeat([1.0, 1.2], [5, 15])
    joints = torch.from_numpy(rebuilt(rest_m[:, 0], bone_directions(rest_m), longer))[0]
    error_m = (moved_joints(halo().bones(joints)) - joints).norm(dim=-1)
    assert float(error_m[:6].max()) < 1e-12
    assert bool((error_m[16:] > 0.012).all())


def test_the_naive_transform_starts_every_bone_on_its_joint_and_turns_it_the_right_way():
    joints = sample(30)
    matrices = halo(kind=NaiveTransform).bones(joints).matrices()
    starts, ends = STARTS_OF_BONES, list(range(1, 21))
    at_start = (matrices[:, ends, :, :3] * canonical()[starts, None]).sum(-1) + matrices[:, ends, :, 3]
    torch.testing.assert_close(at_start, joints[:, starts])
    along = moved_joints(halo(kind=NaiveTransform).bones(joints))[:, 1:] - joints[:, starts]
    bone = joints[:, 1:] - joints[:, starts]
    cosine = torch.nn.functional.cosine_similarity(along, bone, dim=-1)
    torch.testing.assert_close(cosine, torch.ones_like(cosine))


def test_the_naive_transform_tears_a_turned_hand():
    """Turned about its fingers, a hand keeps its bone directions, so the naive skin does not turn with it."""
    rest = canonical() - canonical()[0]
    along = torch.nn.functional.normalize(rest[3], dim=0)
    flip = 2 * torch.outer(along, along) - torch.eye(3, dtype=torch.float64)
    naive, ours = (kind(canonical_np(), handedness=Handedness.RIGHT).bones(rest @ flip.T).linear[3]
                   for kind in (NaiveTransform, JointTransform))  # fmt: skip
    torch.testing.assert_close(naive, torch.eye(3, dtype=torch.float64))
    torch.testing.assert_close(ours, flip)


@pytest.mark.parametrize("kind", BOTH)
def test_the_palm_of_the_baselines_turns_with_its_frame(kind):
    joints = sample(20)
    ours = JointTransform(canonical_np(), handedness=Handedness.RIGHT)
    turn = ours.frames(joints).S0 @ ours.frames(canonical()).S0.mT
    torch.testing.assert_close(halo(kind=kind).bones(joints).linear[:, 0], turn)


@pytest.mark.parametrize("kind", BOTH)
def test_baselines_are_rotations(kind):
    linear = halo(kind=kind).bones(sample(30)).linear
    identity = torch.eye(3, dtype=torch.float64).expand(30, 21, 3, 3)
    torch.testing.assert_close(linear @ linear.transpose(-1, -2), identity)


@pytest.mark.parametrize("kind", BOTH)
def test_baselines_treat_a_left_hand_as_the_mirrored_right_one(kind):
    joints = sample(10)
    right = halo(kind=kind).bones(joints).matrices()
    left = halo(Handedness.LEFT, kind).bones(mirrored(joints)).matrices()
    torch.testing.assert_close(left, right * torch.tensor([-1.0, 1.0, 1.0], dtype=torch.float64)[:, None])


@pytest.mark.parametrize("kind", BOTH)
def test_baselines_have_finite_gradients(kind):
    joints = sample(10).float().requires_grad_(True)
    halo(kind=kind).bones(joints).matrices().square().sum().backward()
    assert torch.isfinite(joints.grad).all()
