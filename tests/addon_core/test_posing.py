"""Joint positions become bone matrices that give the joints back, and that an animator can work with."""

import numpy as np
import pytest

from blender_addon.core import posing
from blender_addon.core.joints import HANDEDNESSES, LEFT, NAMES, PARENTS, RIGHT
from blender_addon.errors import JGHandFailure
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.hand.sequence import palm_frames


def random_motion(handedness: str, *, frames: int = 60, seed: int = 0) -> np.ndarray:
    """Hands with random bone directions near the rest ones, random lengths and palms, anywhere, turned anyhow."""
    rng = np.random.default_rng(seed)
    joints = np.tile(posing.rest_joints_m(handedness), (frames, 1, 1))
    for place in range(1, 21):
        parent = PARENTS[place]
        bone = posing.rest_joints_m(handedness)[place] - posing.rest_joints_m(handedness)[parent]
        turned = bone + 0.8 * np.linalg.norm(bone) * rng.standard_normal((frames, 3)) * (0.1 if parent == 0 else 1.0)
        joints[:, place] = joints[:, parent] + turned * rng.uniform(0.7, 1.3, (frames, 1))
    turns = np.linalg.qr(rng.standard_normal((frames, 3, 3)))[0]
    turns *= np.linalg.det(turns)[:, None, None]
    return np.einsum("fij,fkj->fki", turns, joints) + rng.uniform(-1, 1, (frames, 1, 3))


def posed_heads(keys: posing.BoneKeys, rest: np.ndarray) -> np.ndarray:
    """(F, 21, 3) bone heads as Blender computes them from what is keyed."""
    frames = len(keys.location)
    pose = np.empty((frames, 21, 4, 4))
    for place, parent in enumerate(PARENTS):
        basis = np.tile(np.eye(4), (frames, 1, 1))
        basis[:, :3, :3] = rotations(keys.quaternion[:, place])
        basis[:, :3, 3] = keys.location[:, place]
        above = rest[place] if parent < 0 else pose[:, parent] @ np.linalg.inv(rest[parent]) @ rest[place]
        pose[:, place] = above @ basis
    return pose[..., :3, 3]


def rotations(quaternion: np.ndarray) -> np.ndarray:
    w, x, y, z = quaternion.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_any_motion_comes_back_from_its_keys(handedness):
    motion = random_motion(handedness)
    rest = posing.rest_matrices(posing.rest_joints_m(handedness), handedness)
    keys = posing.bone_keys(motion, rest, handedness)
    # worst observed 6.7e-16 m
    np.testing.assert_allclose(posed_heads(keys, rest), motion, atol=2e-15)


def test_left_and_right_rest_hands_are_mirror_images():
    mirror = np.diag([-1.0, 1.0, 1.0])
    right, left = (posing.rest_matrices(posing.rest_joints_m(h), h)[:, :3, :3] for h in (RIGHT, LEFT))
    # a mirrored rotation keeps its axis up to sign: x turns round so that +x bends both hands
    np.testing.assert_allclose(left, mirror @ right @ np.diag([-1.0, 1.0, 1.0]), atol=1e-14)


def test_quaternions_of_neighboring_frames_are_near_each_other():
    rest = posing.rest_matrices(posing.rest_joints_m(RIGHT), RIGHT)
    angle = np.linspace(0, 8 * np.pi, 400)
    zero, one = np.zeros_like(angle), np.ones_like(angle)
    turn = np.array([[np.cos(angle), -np.sin(angle), zero], [np.sin(angle), np.cos(angle), zero], [zero, zero, one]])
    motion = np.einsum("ijf,kj->fki", turn, posing.rest_joints_m(RIGHT))
    quaternion = posing.bone_keys(motion, rest, RIGHT).quaternion
    assert np.sum(quaternion[1:] * quaternion[:-1], -1).min() > 0.99


def test_a_rest_hand_made_for_a_motion_has_its_median_lengths():
    motion = random_motion(RIGHT, seed=5)
    rest = posing.rest_joints_m(RIGHT, motion)
    for place in range(1, 21):
        lengths = np.linalg.norm(motion[:, place] - motion[:, PARENTS[place]], axis=-1)
        assert np.linalg.norm(rest[place] - rest[PARENTS[place]]) == pytest.approx(np.median(lengths))


def test_straight_folded_and_vanished_fingers_stay_finite_and_exact():
    joints = posing.rest_joints_m(RIGHT)
    rest = posing.rest_matrices(joints, RIGHT)
    folded, vanished, straight, on_a_line = (joints.copy() for _ in range(4))
    folded[NAMES.index("index3")] = folded[NAMES.index("index1")]
    folded[NAMES.index("index4")] = 2 * folded[NAMES.index("index1")] - folded[NAMES.index("index2")]
    vanished[5:9] = vanished[5]
    for level in range(1, 4):
        straight[8 + level + 1] = straight[9] + 0.03 * level * np.array([0.0, 1, 0])
    on_a_line[:, [0, 2]] = 0
    motion = np.stack([joints, folded, vanished, straight, on_a_line, joints])
    keys = posing.bone_keys(motion, rest, RIGHT)
    assert np.isfinite(keys.location).all()
    np.testing.assert_allclose(np.linalg.norm(keys.quaternion, axis=-1), 1)
    np.testing.assert_allclose(posed_heads(keys, rest), motion, atol=1e-15)


@pytest.mark.parametrize(
    "joints",
    [np.zeros((3, 20, 3)), np.zeros((21, 3)), np.zeros((0, 21, 3)), np.full((1, 21, 3), np.nan), np.zeros((2, 21, 3))],
    ids=["20 joints", "one frame without a frame axis", "no frame", "not numbers", "all in one place"],
)
def test_what_is_no_motion_is_refused(joints):
    rest = posing.rest_matrices(posing.rest_joints_m(RIGHT), RIGHT)
    with pytest.raises(JGHandFailure) as caught:
        posing.bone_keys(joints, rest, RIGHT)
    assert caught.value.kind == "bad_joints"


def test_a_rest_pose_with_a_bone_of_no_length_is_refused():
    joints = posing.rest_joints_m(RIGHT)
    joints[6] = joints[5]
    with pytest.raises(JGHandFailure, match="index2"):
        posing.rest_matrices(joints, RIGHT)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_the_palm_in_whose_axes_a_forearm_turns_is_the_engines(handedness):
    """A right angle about an axis of the palm is one about that of the engine's frame, mirrored for a left hand."""
    joints_m = random_motion(handedness, frames=20)
    mirror = np.diag([-1.0 if handedness == LEFT else 1.0, 1.0, 1.0])
    palm, has_palm = palm_frames(to_level(joints_m @ mirror, JointOrder.STANDARD))
    assert has_palm.all()
    for axis in range(3):
        quaternion = np.tile(np.sqrt(0.5) * np.eye(4)[0] + np.sqrt(0.5) * np.eye(4)[1 + axis], (20, 1))
        turned = posing.forearm_rotations(joints_m, handedness, quaternion)
        expected = mirror @ palm @ rotations(quaternion) @ palm.swapaxes(1, 2) @ mirror
        np.testing.assert_allclose(turned, expected, atol=1e-12)
        np.testing.assert_allclose(posing.forearm_turns(joints_m, handedness, turned), quaternion, atol=1e-12)


@pytest.mark.parametrize("handedness", HANDEDNESSES)
def test_a_frame_without_a_palm_has_that_of_the_frame_before(handedness):
    joints_m = random_motion(handedness, frames=4)
    for place in (0, 2):  # wrist and knuckles on a line
        joints_m[place, [0, 5, 9, 13, 17]] = np.outer(np.arange(5), [0.01, 0.02, 0.03])
    assert posing.has_palm(joints_m).tolist() == [False, True, False, True]
    frames = posing.palm_frames(joints_m, handedness)
    np.testing.assert_array_equal(frames, posing.palm_frames(joints_m[[1, 1, 1, 3]], handedness))
    mirror = np.diag([-1.0 if handedness == LEFT else 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(posing.palm_frames(joints_m[::2], handedness), [mirror, mirror])
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (4, 1))
    rest = posing.rest_matrices(posing.rest_joints_m(handedness), handedness)
    keys = posing.bone_keys(joints_m, rest, handedness, (posing.forearm_rest(rest, handedness), turns))
    assert np.isfinite(keys.location).all()
    assert np.isfinite(keys.quaternion).all()
