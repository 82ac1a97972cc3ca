"""Cameras that show a whole motion: upright, from the named side, nothing cut off."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.hand.poses import named_pose
from jghand_engine.native import contract
from jghand_engine.render.framing import INDEX, MIDDLE, PINKY, VIEWS, WRIST, framing_camera, hand_axes
from jghand_engine.template.builtin import load_template

WIDTH, HEIGHT = 512, 334


def motion(handedness=Handedness.RIGHT):
    canonical = load_template().joints_m.copy()
    return np.stack(
        [named_pose(name, canonical, handedness=handedness) for name in ("open", "fist", "spread", "point")]
    )


def pixels(camera, points_m):
    uv, depth = camera.project(points_m)
    assert float(depth.min()) > contract.Z_NEAR_M
    return uv


@pytest.mark.parametrize("turn", [(0, 0, 0), (100, -40, 60), (10, 170, 95)])
@pytest.mark.parametrize("handedness", Handedness)
@pytest.mark.parametrize("view", VIEWS)
def test_every_joint_of_every_frame_is_in_the_picture(view, handedness, turn):
    joints = motion(handedness) @ Rotation.from_euler("xyz", turn, degrees=True).as_matrix().T + (1.0, -2.0, 3.0)
    camera = framing_camera(joints, handedness, view, width=WIDTH, height=HEIGHT)
    uv = pixels(camera, joints)
    assert uv.min() > 0
    assert (uv < (WIDTH, HEIGHT)).all()


@pytest.mark.parametrize("view", VIEWS)
def test_the_skin_of_the_canonical_hand_is_in_the_picture_and_fills_it(view):
    template = load_template()
    camera = framing_camera(template.joints_m[None], Handedness.RIGHT, view, width=WIDTH, height=HEIGHT)
    uv = pixels(camera, template.vertices_m)
    assert uv.min() > 0
    assert (uv < (WIDTH, HEIGHT)).all()
    filled = ((uv.max(0) - uv.min(0)) / (WIDTH, HEIGHT)).max()
    assert filled > 0.7, "smallest seen: 0.737"


@pytest.mark.parametrize("turn", [(0, 0, 0), (100, -40, 60)])
@pytest.mark.parametrize("handedness", Handedness)
@pytest.mark.parametrize("view", ["front", "back", "side", "outside", "quarter", "quarter-back"])
def test_the_hand_stands_upright(view, handedness, turn):
    joints = motion(handedness) @ Rotation.from_euler("xyz", turn, degrees=True).as_matrix().T
    uv = pixels(framing_camera(joints, handedness, view, width=WIDTH, height=HEIGHT), joints)
    assert (uv[:, MIDDLE, 1] < uv[:, WRIST, 1]).all()
    along = (uv[:, MIDDLE] - uv[:, WRIST]).mean(0)
    assert abs(along[0]) < 0.3 * -along[1]


@pytest.mark.parametrize(
    ("view", "handedness", "index_is_right"),
    [("front", "right", True), ("front", "left", False), ("back", "right", False), ("back", "left", True)],
)
def test_palm_and_back_are_not_mixed_up(view, handedness, index_is_right):
    """The palm of a right hand shows its index finger on the right of the picture."""
    joints = motion(Handedness(handedness))
    uv = pixels(framing_camera(joints, Handedness(handedness), view, width=WIDTH, height=HEIGHT), joints)
    assert (uv[:, INDEX, 0] > uv[:, PINKY, 0]).all() == index_is_right


@pytest.mark.parametrize(
    ("view", "to_eye"),
    [("front", (0, 0, 1)), ("back", (0, 0, -1)), ("side", (1, 0, 0)), ("outside", (-1, 0, 0)), ("top", (0, 1, 0))],
)
def test_a_camera_stands_straight_before_the_side_that_it_is_named_by(view, to_eye):
    camera = framing_camera(load_template().joints_m[None], Handedness.RIGHT, view, width=WIDTH, height=HEIGHT)
    np.testing.assert_allclose(-camera.camera_from_world[2, :3], to_eye, atol=1e-12)


@pytest.mark.parametrize("handedness", Handedness)
def test_hand_axes_of_the_canonical_hand_are_its_frame(handedness):
    sign = 1 if handedness is Handedness.RIGHT else -1
    joints = load_template().joints_m * (sign, 1, 1)
    axes = hand_axes(joints[None], handedness)
    assert np.allclose(axes, np.diag([sign, 1, 1]), atol=1e-12)


def test_a_hand_that_turns_all_the_way_round_is_framed_from_its_first_frame():
    turns = Rotation.from_euler("y", np.linspace(0, 360, 24, endpoint=False)[:, None], degrees=True).as_matrix()
    still = motion()[:1]
    turning = still @ turns.transpose(0, 2, 1)
    first = framing_camera(still, Handedness.RIGHT, "front", width=WIDTH, height=HEIGHT)
    camera = framing_camera(turning, Handedness.RIGHT, "front", width=WIDTH, height=HEIGHT)
    assert np.allclose(camera.camera_from_world[:3, :3], first.camera_from_world[:3, :3])
    uv = pixels(camera, turning)
    assert uv.min() > 0
    assert (uv < (WIDTH, HEIGHT)).all()


def test_a_real_wrist_centered_capture_is_upright_and_whole(shared_data):
    joints = to_level(np.load(shared_data / "real/human_joint_right.npy", allow_pickle=False), JointOrder.STANDARD)
    uv = pixels(framing_camera(joints, Handedness.RIGHT, "front", width=WIDTH, height=HEIGHT), joints)
    assert uv.min() > 0
    assert (uv < (WIDTH, HEIGHT)).all()
    assert (uv[:, MIDDLE, 1] < uv[:, WRIST, 1] - 0.2 * HEIGHT).all()
    assert (uv[:, INDEX, 0] > uv[:, PINKY, 0]).all()


def test_a_frame_in_which_all_joints_fall_together_turns_no_camera():
    joints = motion(Handedness.RIGHT)[:2]
    lost = np.concatenate([joints, np.tile(joints[:1, :1], (1, 21, 1))])
    one, other = (
        framing_camera(all_, Handedness.RIGHT, "front", width=WIDTH, height=HEIGHT) for all_ in (joints, lost)
    )
    np.testing.assert_allclose(other.camera_from_world[:3, :3], one.camera_from_world[:3, :3], atol=1e-12)


def test_joints_on_one_line_have_no_palm():
    joints = np.zeros((2, 21, 3))
    joints[..., 1] = np.arange(21) * 0.01
    with pytest.raises(InputError, match="palm"):
        framing_camera(joints, Handedness.RIGHT, "front", width=WIDTH, height=HEIGHT)


def test_an_unknown_view_lists_the_known_ones():
    with pytest.raises(InputError, match="quarter"):
        framing_camera(motion(), Handedness.RIGHT, "above", width=WIDTH, height=HEIGHT)
