"""The poses of the library are whole, mirrored for the left hand, and drawn without an engine."""

from __future__ import annotations

import numpy as np
import pytest
from build_pose_table import joints_of

from blender_addon.core import poses
from blender_addon.core.joints import HANDEDNESSES, LEFT, NAMES, RIGHT, TIPS, WRIST

MOVING = [name for place, name in enumerate(NAMES) if place != WRIST and place not in TIPS]


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_every_pose_turns_every_finger_bone_and_has_a_name_of_its_own(handedness):
    every = poses.all_poses(handedness)
    assert {"flat", "relaxed", "fist", "point", "pinch", "ASL A", "ASL Y"} <= {pose.name for pose in every}
    assert len({pose.title for pose in every}) == len(every)
    for pose in every:
        assert sorted(pose.turns) == sorted(MOVING)
        # five digits
        np.testing.assert_allclose(np.linalg.norm(list(pose.turns.values()), axis=-1), 1, atol=2e-5)


def test_left_poses_are_the_mirror_images_of_right_ones():
    for right, left in zip(poses.all_poses(RIGHT), poses.all_poses(LEFT), strict=True):
        assert left.name == right.name
        np.testing.assert_allclose(joints_of(left), joints_of(right) * (-1, 1, 1), atol=1e-12)


def test_a_fist_is_small_and_a_point_points_with_the_index_finger_alone():
    flat, fist, point = (joints_of(poses.pose_named(name, RIGHT)) for name in ("flat", "fist", "point"))
    tips = list(TIPS[1:])
    reach = [np.linalg.norm(hand[tips] - hand[0], axis=-1) for hand in (flat, fist, point)]
    # observed 0.35 to 0.44
    assert (reach[1] < 0.5 * reach[0]).all()
    assert reach[2][0] > 0.9 * reach[0][0]
    assert (reach[2][1:] < 0.5 * reach[0][1:]).all()


def test_the_tips_of_a_pinch_meet():
    pinch = joints_of(poses.pose_named("pinch", RIGHT))
    # their joints are 7.2 mm apart, as far as the skin of both is thick
    assert 0.0065 < np.linalg.norm(pinch[NAMES.index("thumb4")] - pinch[NAMES.index("index4")]) < 0.008


def test_knuckles_of_a_fist_draw_together_and_those_of_an_open_hand_stay():
    fist, open_hand = (poses.pose_named(name, RIGHT).knuckles for name in ("fist", "open"))
    assert not np.any(list(open_hand.values()))
    # index to the middle, ring and pinky back to it and into the palm, as parts of their distances from the wrist
    assert fist["index1"][0] < -0.02
    assert fist["pinky1"][0] > 0.05
    assert fist["pinky1"][2] > 0.05
    assert poses.pose_named("fist", LEFT).knuckles["index1"][0] == -fist["index1"][0]
