"""The poses of the library are whole, mirrored for the left hand, and drawn without an engine."""

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
