"""A forearm's turn in slices: what bends, what twists, and the hard cases of quaternions."""

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from jghand_engine.avatar.avatar import FOREARM_WAY
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.rotations import quaternion_rotation
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.hand.wrist import BEND_M, NO_TURN, SLICES_M, Wrist, slice_shares, unit_turns
from jghand_engine.template.builtin import load_template

SKELETON = Skeleton(load_template().joints_m, handedness=Handedness.RIGHT, forearm_way=FOREARM_WAY)
PALM = SKELETON.canonical.frames[0]
AXIS = PALM.T @ FOREARM_WAY / np.linalg.norm(FOREARM_WAY)
WRIST = Wrist(PALM, FOREARM_WAY)
LEFT = np.array([-1.0, 1.0, 1.0])


def turn(axis: ArrayLike, degrees: float) -> np.ndarray:
    return Rotation.from_rotvec(np.radians(degrees) * np.asarray(axis, float)).as_quat()[[3, 0, 1, 2]]


def degrees(rotations: np.ndarray) -> np.ndarray:
    return np.degrees(Rotation.from_matrix(rotations).magnitude())


def test_a_forearm_that_is_not_turned_adds_nothing_to_any_bone():
    rest = SKELETON.bones(load_template().joints_m)
    for straight in (NO_TURN, -NO_TURN, 3 * NO_TURN):
        bones = SKELETON.bones(load_template().joints_m, forearm=straight)
        assert np.array_equal(bones.linear_offset, rest.linear_offset)
    assert not rest.linear_offset[JOINT_COUNT:].any()


def test_shares_are_those_of_the_two_slices_around_a_place():
    places_m = np.linspace(-0.05, 0.2, 500)
    shares = slice_shares(places_m)
    assert ((shares > 0).sum(1) <= 2).all()
    assert (shares[places_m < SLICES_M[0]] == 0).all(), "the hand follows its palm"
    assert np.allclose(shares[places_m > SLICES_M[1]].sum(1), 1)


def test_twist_grows_evenly_from_the_wrist_on_and_a_bend_is_whole_behind_it():
    twisted, bent = WRIST.slice_rotations(turn(AXIS, 90)), WRIST.slice_rotations(turn((0, 1, 0), -60))
    np.testing.assert_allclose(degrees(twisted), 90 * (SLICES_M[1:] / 0.125).clip(0), atol=1e-6)
    behind = SLICES_M[1:] >= BEND_M[1]
    # the axis of flexion is not quite square to the forearm: a little of the turn is twist
    np.testing.assert_allclose(degrees(bent)[behind], 60, atol=2)
    assert (np.diff(degrees(bent)) > -0.5).all()
    assert np.diff(degrees(bent)).max() < 20, "no crease between two slices"


@pytest.mark.parametrize("seed", range(3))
def test_the_end_has_the_whole_turn_whatever_it_is(seed):
    for rotation in Rotation.random(20, seed):
        quaternion = rotation.as_quat()[[3, 0, 1, 2]]
        slices = WRIST.slice_rotations(quaternion)
        np.testing.assert_allclose(slices[-1], rotation.as_matrix(), atol=1e-12)
        np.testing.assert_allclose(np.linalg.det(slices), 1, atol=1e-12)
        assert np.array_equal(slices, WRIST.slice_rotations(-quaternion))


@pytest.mark.parametrize("axis", [AXIS, np.array([0.0, 1, 0]), np.cross(AXIS, [1, 0, 0]), np.array([0.6, 0, -0.8])])
def test_a_half_turn_goes_one_way_whatever_its_sign_and_its_rounding(axis):
    axis = axis / np.linalg.norm(axis)
    half = turn(axis, 180)
    slices = WRIST.slice_rotations(half)
    assert np.isfinite(slices).all()
    np.testing.assert_allclose(slices[-1], quaternion_rotation(half), atol=1e-12)
    rounding = np.array([1e-12, 0, 0, 0])
    for near in (-half, half + rounding, half - rounding):
        np.testing.assert_allclose(WRIST.slice_rotations(near), slices, atol=1e-9)


def test_a_left_forearm_is_the_mirror_image_of_the_right_one():
    joints_m, quaternion = load_template().joints_m, turn((0.48, 0.6, 0.64), 70)
    other = Skeleton(joints_m, handedness=Handedness.LEFT, forearm_way=FOREARM_WAY)
    right = SKELETON.bones(joints_m, np.float64, forearm=quaternion)
    left = other.bones(joints_m * LEFT, np.float64, forearm=quaternion)
    np.testing.assert_allclose(left.maps, LEFT[:, None] * right.maps, atol=1e-12)


def test_it_is_the_same_turn_however_the_hand_lies():
    joints_m, quaternion = load_template().joints_m, turn((0.48, 0.6, 0.64), 70)
    moved = Rotation.from_rotvec([0.3, -2, 1]).as_matrix()
    here = SKELETON.bones(joints_m, np.float64, forearm=quaternion)
    there = SKELETON.bones(2 * joints_m @ moved.T + 0.3, np.float64, forearm=quaternion)
    np.testing.assert_allclose(there.maps, 2 * moved @ here.maps, atol=1e-12)


@pytest.mark.parametrize("value", [np.zeros(4), np.full(4, np.nan), np.ones(3), "none", None, [[1, 0, 0, 0], [1]]])
def test_what_is_no_rotation_is_refused(value):
    with pytest.raises(InputError, match="turn of a forearm"):
        unit_turns(value)
