"""What each error of a motion sees, and what it does not."""

import numpy as np
import pytest
from motion_errors import motion_errors

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import PARENTS, Handedness
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions, rebuilt

FOCAL_PX = 500.0


@pytest.fixture(scope="module")
def truth() -> np.ndarray:
    canonical = load_builtin(handedness=Handedness.RIGHT).canonical_joints_m
    poses = [named_pose(name, canonical, handedness=Handedness.RIGHT) for name in ("open", "fist", "point")]
    return np.stack(poses) + np.array([0.0, 0.0, 0.4])


def test_a_hand_of_another_size_farther_away_is_the_same_in_the_picture(truth):
    errors = motion_errors(1.25 * truth, FOCAL_PX, truth, FOCAL_PX)
    figures = [errors.aligned_mm, errors.wrist_mm, errors.place_mm, *errors.camera_deg, *errors.palm_deg, *errors.px]
    assert np.allclose(figures, 0, atol=1e-4)
    assert errors.bones_part == pytest.approx(0, abs=1e-9)


def test_one_scale_serves_the_whole_film(truth):
    sizes = np.array([0.9, 1.0, 1.1])[:, None, None]
    errors = motion_errors(sizes * truth, FOCAL_PX, truth, FOCAL_PX)
    assert errors.aligned_mm == pytest.approx(0, abs=1e-4)
    assert errors.wrist_mm > 4


def test_a_turned_hand_points_elsewhere_but_is_bent_the_same(truth):
    turn = vector_rotation(np.array([[0.0, 0.0, np.radians(10)]]))
    wrist = truth[:, :1]
    errors = motion_errors((truth - wrist) @ turn[0].T + wrist, FOCAL_PX, truth, FOCAL_PX)
    assert errors.palm_deg[1] == pytest.approx(0, abs=1e-5)
    assert errors.aligned_mm == pytest.approx(0, abs=1e-4)
    assert 5 < errors.camera_deg[1] <= 10.0001
    assert errors.wrist_mm == pytest.approx(errors.place_mm)
    assert errors.wrist_mm > 5


def test_a_bent_finger_is_an_error_in_the_palm_too(truth):
    directions, lengths = bone_directions(truth), bone_lengths(truth[0])
    bones = [joint - 1 for joint in range(1, 21) if joint in (7, 12, 17)]
    axis = np.cross(directions[:, 6], (0.0, 0.0, 1.0))
    axis *= np.radians(20) / np.linalg.norm(axis, axis=1, keepdims=True)
    directions[:, bones] = directions[:, bones] @ np.swapaxes(vector_rotation(axis), -1, -2)
    errors = motion_errors(rebuilt(truth[:, 0], directions, lengths), FOCAL_PX, truth, FOCAL_PX)
    assert errors.palm_deg[0] == pytest.approx(0, abs=1e-4)
    assert errors.palm_deg[1] > 10
    assert errors.aligned_mm > 0.5


def test_lengths_are_compared_bone_by_bone(truth):
    lengths = bone_lengths(truth[0]) * np.where(np.arange(20) == PARENTS.index(2) - 1, 1.1, 1.0)
    errors = motion_errors(rebuilt(truth[:, 0], bone_directions(truth), lengths), FOCAL_PX, truth, FOCAL_PX)
    assert errors.bones_part == pytest.approx(0.1 / 20)
    assert errors.camera_deg[1] == pytest.approx(0, abs=1e-5)


def test_pixels_are_those_of_each_focal_length(truth):
    farther = truth * (1.0, 1.0, 1.2)
    assert motion_errors(farther, 1.2 * FOCAL_PX, truth, FOCAL_PX).px[1] == pytest.approx(0, abs=1e-9)
    aside = truth + truth[..., 2:] * (2 / FOCAL_PX, 0.0, 0.0)
    assert motion_errors(aside, FOCAL_PX, truth, FOCAL_PX).px == pytest.approx((2.0, 2.0))
