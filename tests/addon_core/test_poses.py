"""The poses that the extension offers are the engine's, on any hand, mirrored for the left one."""

import numpy as np
import pytest

from blender_addon.core import kinematics, poses, posing
from blender_addon.core.joints import HANDEDNESSES, LEFT, NAMES, RIGHT, TIPS, WRIST
from jghand_engine.avatar.file import load_avatar
from jghand_engine.captures.making.rig import identity_names, load_identity
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, from_level, to_level
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import POSES_DEG, letter_angles_on
from jghand_engine.learn.fist import ON_PALM, gaps_of
from jghand_engine.template.builtin import ASSETS

MOVING = [name for place, name in enumerate(NAMES) if place != WRIST and place not in TIPS]


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_every_pose_turns_every_finger_bone_and_has_a_name_of_its_own(handedness):
    every = poses.ALL_POSES
    assert {"flat", "relaxed", "fist", "point", "pinch", "ASL A", "ASL Y"} <= {pose.name for pose in every}
    assert len({pose.title(handedness) for pose in every}) == len(every)
    rest = posing.rest_matrices(posing.rest_joints_m(handedness), handedness)
    for pose in every:
        turns = poses.pose_on(pose.name, rest, handedness).turns
        assert sorted(turns) == sorted(MOVING)
        np.testing.assert_allclose(np.linalg.norm(list(turns.values()), axis=-1), 1, atol=1e-12)


@pytest.mark.parametrize("identity", identity_names())
def test_a_pose_is_what_the_engine_poses_on_that_hand(identity):
    canonical_m = load_identity(identity).joints_m
    rest_m = from_level(canonical_m, JointOrder.STANDARD)
    fist = kinematics.Fist((3.0, -2.0, 1.0), (0.005, 0.0, -0.005), 0.006)
    fists = (kinematics.NO_FIST, fist) if identity == "child" else (fist, kinematics.NO_FIST)
    for side, its_fist in zip(Handedness, fists, strict=True):
        own_m = rest_m * (-1, 1, 1) if side is Handedness.LEFT else rest_m
        for name in POSES_DEG:
            wanted = from_level(named_pose(name, canonical_m, handedness=side, fist=its_fist), JointOrder.STANDARD)
            np.testing.assert_array_equal(poses.joints_on(name, own_m, side, its_fist), wanted)
    hand = kinematics.ArchingHand(canonical_m)
    wanted = from_level(hand.joints(letter_angles_on(hand, "A")[None])[0], JointOrder.STANDARD)
    np.testing.assert_array_equal(poses.joints_on("ASL A", rest_m, RIGHT), wanted)


@pytest.mark.parametrize("file", ["builtin_right.jghand", "hands/strong.jghand"])
def test_a_fist_closes_on_an_armature_whose_directions_are_the_built_in_hands(file):
    """Worst seen: neighbors -0.3 and 0.4 mm, tips -1.3 and -0.5; up to 0.6 mm from those of the hand's own."""
    avatar = load_avatar(ASSETS / file)
    own = None if avatar.own_joints_m is None else from_level(avatar.own_joints_m, JointOrder.STANDARD)[None]
    joints_m = poses.joints_on("fist", posing.rest_joints_m(RIGHT, own), RIGHT, avatar.fist)
    gaps = gaps_of(avatar)(to_level(joints_m, JointOrder.STANDARD))
    assert (np.abs(gaps.neighbors()) < 0.6).all()
    assert (np.abs(gaps.palm(ON_PALM) + 1.2) < 0.8).all()


def test_left_turns_and_ways_are_the_mirror_images_of_right_ones():
    right, left = (
        poses.pose_on("fist", posing.rest_matrices(posing.rest_joints_m(side), side), side) for side in (RIGHT, LEFT)
    )
    for name, turn in right.turns.items():
        np.testing.assert_allclose(left.turns[name], np.array(turn) * (1, 1, -1, -1), atol=1e-12)
    for name, way in right.knuckles.items():
        np.testing.assert_allclose(left.knuckles[name], np.array(way) * (-1, 1, 1), atol=1e-12)


@pytest.mark.parametrize("unit", [0.01, 1.0, 100.0])
def test_a_pose_does_not_depend_on_the_unit_of_the_armature(unit):
    rest = posing.rest_joints_m(RIGHT)
    np.testing.assert_allclose(
        poses.joints_on("fist", unit * rest, RIGHT) / unit, poses.joints_on("fist", rest, RIGHT), atol=1e-9
    )


def test_a_hand_that_is_out_of_shape_at_rest_is_turned_as_the_built_in_hand():
    rest_m = posing.rest_joints_m(RIGHT)
    flat = rest_m.copy()
    flat[9] = 1.02 * rest_m[5]  # two palm bones in one direction: nothing says where the palm is
    built_in = posing.rest_matrices(rest_m, RIGHT)
    bent = built_in.copy()
    bent[:, :3, 3] = flat
    assert poses.pose_on("fist", bent, RIGHT) == poses.pose_on("fist", built_in, RIGHT)
