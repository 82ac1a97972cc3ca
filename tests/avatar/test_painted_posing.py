"""The native skinning poses as `pose_gaussians` does."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.blocks import Blocks, compact_order
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.posing import Poser
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.learn.skeleton import JointTransform
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.native.binding import Library
from jghand_engine.native.tasks import LANES
from jghand_engine.native.threads import shared_pool


def skinned(library: Library, avatar: HandAvatar, joints_m: np.ndarray, threads: int = 1, shift_m=(0.0, 0.0, 0.0)):
    """Positions and radii in the avatar's order."""
    poser = Poser(library, avatar)
    into = poser.into
    into.position_m[:], into.sigma_m[:] = np.nan, np.nan
    bones = avatar.skeleton().bones(joints_m)
    poser.prepare(bones, np.array(shift_m))
    shared_pool(threads).run(lambda _thread: poser.run())
    inverse = np.argsort(poser.blocks.order)
    assert (into.sigma_m[len(avatar) :] == 0).all()
    return into.position_m[: len(avatar)][inverse], into.sigma_m[: len(avatar)][inverse]


@pytest.mark.parametrize("handedness", list(Handedness))
@pytest.mark.parametrize("pose", ["open", "fist", "pinch"])
def test_native_skinning_agrees_with_the_float64_chain(library: Library, pose: str, handedness: Handedness):
    avatar = load_painted(handedness=handedness).prefix(5003)
    canonical = avatar.canonical_joints_m
    # bones of other lengths, so that radii are scaled too
    joints = 1.2 * named_pose(pose, canonical, handedness=handedness)
    joints[1:] += np.random.default_rng(3).normal(0, 2e-3, (20, 3))
    bones = JointTransform(avatar.canonical_joints_m, handedness=handedness).bones(torch.from_numpy(joints))
    exact = pose_gaussians(avatar, bones)
    position, sigma = skinned(library, avatar, joints)
    assert np.abs(position + joints[0] - exact.position_m.numpy()).max() < 1.5e-7  # observed 8e-8 m
    relative = sigma / exact.sigma_m.numpy() - 1
    assert np.abs(relative).max() < 3e-6  # observed 1.2e-6
    assert relative.std() > 0


def test_posed_hand_is_shifted_last(library: Library):
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(100)
    joints = named_pose("relaxed", avatar.canonical_joints_m, handedness=Handedness.RIGHT)
    near, _ = skinned(library, avatar, joints)
    far, _ = skinned(library, avatar, joints, shift_m=(0.5, -0.25, 2.0))
    assert np.abs(far - near - np.array([0.5, -0.25, 2.0])).max() < 3e-7


@pytest.mark.parametrize("count", [1, 15, 16, 17])
def test_any_number_of_gaussians_can_be_skinned(library: Library, count: int):
    avatar = load_painted(handedness=Handedness.RIGHT)
    arrays = ("position_m", "sigma_m", "opacity", "rgb", "bone_weights", "uvd")
    avatar = replace(avatar, **{name: getattr(avatar, name)[:count] for name in arrays})
    position, sigma = skinned(library, avatar, avatar.canonical_joints_m)
    assert np.abs(position - avatar.position_m).max() < 1e-7  # the canonical pose changes nothing
    assert np.abs(sigma / avatar.sigma_m - 1).max() < 3e-6


def _read_only(array: np.ndarray) -> np.ndarray:
    array.flags.writeable = False
    return array


@pytest.mark.parametrize(
    ("name", "make", "wanted"),
    [
        ("position_m", lambda rows: np.zeros((rows, 3)), "float32"),
        ("position_m", lambda rows: np.zeros((rows - 16, 3), np.float32), r"\(\d+, 3\)"),
        ("sigma_m", lambda rows: np.zeros(rows - 1, np.float32), r"shape \(\d+,\)"),
        ("sigma_m", lambda rows: np.zeros(2 * rows, np.float32)[::2], "contiguous"),
        ("sigma_m", lambda rows: _read_only(np.zeros(rows, np.float32)), "written"),
    ],
)
def test_arrays_that_the_kernel_cannot_write_into_are_refused_by_name(library: Library, name, make, wanted):
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(100)
    poser = Poser(library, avatar)
    bones = avatar.skeleton().bones(avatar.canonical_joints_m)
    with pytest.raises(InputError, match=f"{name}.*{wanted}"):
        Poser(library, avatar, replace(poser.into, **{name: make(poser.blocks.rows)}))
    with pytest.raises(InputError, match="linear_offset"):
        poser.prepare(replace(bones, linear_offset=bones.linear_offset[:20]), np.zeros(3))


def test_blocks_hold_all_points_and_are_small():
    points = load_painted(handedness=Handedness.RIGHT).position_m
    blocks = Blocks.of(points)
    assert np.array_equal(np.sort(blocks.order), np.arange(len(points)))
    whole = len(points) // LANES * LANES
    sides_m = np.ptp(points[blocks.order[:whole]].reshape(-1, LANES, 3), axis=1).max(1)
    # 3.7 mm: 60,000 on the skin of a hand
    assert np.median(sides_m) < 0.004


def test_points_in_one_place_keep_their_order():
    assert len(compact_order(np.zeros((0, 3)))) == 0
    assert np.array_equal(compact_order(np.zeros((40, 3))), np.arange(40))
