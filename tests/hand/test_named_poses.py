"""Named poses on any canonical hand, and motions through them."""

import math

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import RANGES_DEG, TIP_THICKNESS_PART, ArticulatedHand
from jghand_engine.hand.orders import bone_lengths, check_order
from jghand_engine.hand.poses import MotionOptions, minimum_jerk, named_pose, pose_sequence_of_names
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN
from jghand_engine.hand.shapes import POSES_DEG, named_angles, pose_names
from jghand_engine.learn.skeleton import JointTransform

CANONICAL = hands.canonical_np()
FINGERTIPS = slice(17, 21)


def with_a_human_thumb() -> np.ndarray:
    """The sampled hand's thumb starts 30 mm nearer to the wrist's axis than a human one."""
    canonical = CANONICAL.copy()
    canonical[[1, 6, 11, 16]] = [[-0.030, 0.021, -0.007], [-0.048, 0.055, -0.024], [-0.058, 0.074, -0.036],
                                 [-0.068, 0.097, -0.051]]  # fmt: skip
    return canonical


def _other_hands():
    """Canonical hands of other proportions, places and rest poses."""
    flat = hands.flat().numpy()
    small = 0.6 * hands.sample(1, seed=4, palm_m=0.001, bone=0.1, shift_m=0.0, turned=False)[0].numpy()
    turned = hands.canonical() @ hands.random_rotations(1, torch.Generator().manual_seed(0))[0].T
    return [CANONICAL, flat, small, turned.numpy() + 0.4]


@pytest.mark.parametrize("name", pose_names())
def test_poses_keep_wrist_middle_knuckle_and_bone_lengths(name):
    for canonical in _other_hands():
        joints = named_pose(name, canonical, handedness=Handedness.RIGHT)
        assert joints.shape == (21, 3)
        assert np.abs(joints[[0, 1, 3]] - canonical[[0, 1, 3]]).max() < 1e-15
        assert np.abs(bone_lengths(joints) - bone_lengths(canonical)).max() < 1e-15
        check_order(joints)


@pytest.mark.parametrize("name", pose_names())
def test_poses_stay_inside_the_ranges(name):
    angles = named_angles(name)
    assert (angles >= RANGES_DEG[..., 0]).all()
    assert (angles <= RANGES_DEG[..., 1]).all()


def test_the_rest_pose_of_the_canonical_hand_does_not_matter():
    # the same bones, once straight and once bent at rest: equal bend of the fingers in a fist
    bent = JointTransform(CANONICAL, handedness=Handedness.RIGHT, swing="euler").frames(
        torch.from_numpy(named_pose("fist", CANONICAL, handedness=Handedness.RIGHT))
    )
    flat = hands.flat().numpy()
    straight = JointTransform(flat, handedness=Handedness.RIGHT, swing="euler").frames(
        torch.from_numpy(named_pose("fist", flat, handedness=Handedness.RIGHT))
    )
    flexion = [frames.angles.reshape(3, 5, 2)[:, 1:, 0] for frames in (bent, straight)]
    # each lies on its own palm: observed 5.0 degrees, of the pinky
    assert (flexion[0] - flexion[1]).abs().max() < np.radians(6)


def _reach(joints):
    """Distance of the fingertips index..pinky from their knuckles."""
    return np.linalg.norm(joints[FINGERTIPS] - joints[2:6], axis=1)


def test_a_fist_is_closed_towards_the_palm_and_an_open_hand_straight():
    chain = bone_lengths(CANONICAL)[5:].reshape(3, 5)[:, 1:].sum(axis=0)
    assert (_reach(named_pose("fist", CANONICAL, handedness=Handedness.RIGHT)) < 0.5 * chain).all()
    assert (_reach(named_pose("open", CANONICAL, handedness=Handedness.RIGHT)) > 0.98 * chain).all()
    # the palm of the sampled hands looks along -z
    knuckle_height = CANONICAL[2:6, 2]
    assert (named_pose("grasp", CANONICAL, handedness=Handedness.RIGHT)[FINGERTIPS, 2] < knuckle_height - 0.03).all()


@pytest.mark.parametrize(
    ("name", "stretched"),
    [("point", [1]), ("victory", [1, 2]), ("three", [1, 2, 3]), ("four", [1, 2, 3, 4]), ("rock", [1, 4])],
)
def test_counting_poses_stretch_their_fingers_only(name, stretched):
    chain = bone_lengths(CANONICAL)[5:].reshape(3, 5)[:, 1:].sum(axis=0)
    straight = _reach(named_pose(name, CANONICAL, handedness=Handedness.RIGHT)) > 0.95 * chain
    assert [finger + 1 for finger in np.flatnonzero(straight)] == stretched


def test_spreading_moves_the_fingertips_apart():
    def gaps(name):
        return np.linalg.norm(
            np.diff(named_pose(name, CANONICAL, handedness=Handedness.RIGHT)[FINGERTIPS], axis=0), axis=1
        )

    assert (gaps("spread") > gaps("open") + 0.005).all()
    assert (gaps("flat") < gaps("open")).all()


@pytest.mark.parametrize("name", ["pinch", "ok"])
def test_tips_touch(name):
    # the skin of the tips, that is, which lies so far from their joints, on a hand of usual proportions
    canonical = with_a_human_thumb()
    joints = named_pose(name, canonical, handedness=Handedness.RIGHT)
    between_m = TIP_THICKNESS_PART * middle_finger_m(canonical)
    assert abs(np.linalg.norm(joints[16] - joints[17]) - between_m) < 0.001


def middle_finger_m(joints: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(joints[[0, 3, 8, 13, 18]], axis=0), axis=1).sum())


def test_left_hand_is_the_mirror_image():
    for name in ("pinch", "victory"):
        right, left = (
            named_pose(name, CANONICAL, handedness=Handedness.RIGHT),
            named_pose(name, CANONICAL, handedness=Handedness.LEFT),
        )
        assert np.array_equal(left, right * [-1, 1, 1])


def test_angles_outside_the_ranges_are_clamped():
    hand = ArticulatedHand(CANONICAL)
    extreme = np.full((1, 5, 4), 500.0)
    assert np.array_equal(hand.joints(extreme)[0], hand.joints(RANGES_DEG[..., 1][None])[0])


def test_unknown_pose_lists_the_known():
    with pytest.raises(InputError, match="thumb_up"):
        named_pose("jazz", CANONICAL, handedness=Handedness.RIGHT)
    assert set(pose_names()) == set(POSES_DEG)


def test_turns_carry_the_straight_bones_to_the_posed_ones():
    """They turn bones from where they point in the straight hand, one after the other along the finger."""
    hand = ArticulatedHand(CANONICAL)
    angles = np.stack([named_angles("fist"), named_angles("victory")])
    turns, joints, straight = hand.turns(angles), hand.joints(angles), hand.straight_joints_m
    assert turns.shape == (2, 3, 5, 3, 3)
    bones = (joints[:, 6:] - joints[:, 1:16]).reshape(2, 3, 5, 3)
    at_rest = (straight[6:] - straight[1:16]).reshape(3, 5, 3)
    assert np.abs(np.einsum("fklab,klb->fkla", turns, at_rest) - bones).max() < 1e-15


def test_the_ends_of_what_motion_options_may_be_are_allowed():
    least = {"move_s": 0.0, "hold_s": 0.0, "finger_delay": 0.0, "variation_deg": 0.0, "seed": 0}
    for fps in (FPS_MIN, FPS_MAX):
        MotionOptions(fps=fps, **least).check()
    with pytest.raises(InputError, match="finger_delay"):
        MotionOptions(finger_delay=1.0).check()


def test_a_motion_without_time_is_its_poses():
    options = MotionOptions(fps=30.0, move_s=0.0, hold_s=0.0, finger_delay=0.0)
    sequence = pose_sequence_of_names(["open", "fist", "open"], CANONICAL, handedness=Handedness.RIGHT, options=options)
    assert len(sequence) == 3


def test_motion_visits_the_poses_smoothly_and_keeps_the_bones():
    options = MotionOptions(fps=60.0, move_s=0.5, hold_s=0.1)
    names = ["open", "fist", "pinch", "open"]
    sequence = pose_sequence_of_names(names, CANONICAL, handedness=Handedness.RIGHT, options=options)
    assert len(sequence) == 1 + 6 + 3 * (30 + 6)
    assert sequence.fps == 60.0
    assert sequence.handedness is Handedness.RIGHT
    for k, name in enumerate(names):
        assert (
            np.abs(sequence.joints_m[6 + 36 * k] - named_pose(name, CANONICAL, handedness=Handedness.RIGHT)).max()
            < 1e-12
        )
    assert np.ptp(sequence.bone_lengths_m, axis=0).max() < 1e-15
    # no jump: even the fastest joint stays below 3 m/s, and starts and stops softly
    step = np.linalg.norm(np.diff(sequence.joints_m, axis=0), axis=-1)
    assert step.max() * 60.0 < 3.0
    assert np.abs(np.diff(step, axis=0)).max() < 0.35 * step.max()


def test_fingers_of_a_motion_are_late_by_different_times():
    sequence = pose_sequence_of_names(
        ["open", "fist"], CANONICAL, handedness=Handedness.RIGHT, options=MotionOptions(hold_s=0.0)
    )
    moved = np.linalg.norm(sequence.joints_m - sequence.joints_m[0], axis=-1)
    half = [int(np.argmax(moved[:, tip] > moved[-1, tip] / 2)) for tip in range(16, 21)]
    assert len(set(half)) > 1


def test_variation_depends_on_the_seed_only():
    def motion(seed):
        options = MotionOptions(variation_deg=3.0, seed=seed)
        return pose_sequence_of_names(
            ["open", "fist"], CANONICAL, handedness=Handedness.RIGHT, options=options
        ).joints_m

    assert np.array_equal(motion(1), motion(1))
    assert not np.array_equal(motion(1), motion(2))


def test_impossible_motions_are_refused():
    with pytest.raises(InputError, match="at least one name"):
        pose_sequence_of_names([], CANONICAL, handedness=Handedness.RIGHT)


@pytest.mark.parametrize("option", ["fps", "move_s", "hold_s", "finger_delay", "variation_deg"])
@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf, -math.inf])
def test_impossible_motion_options_are_named(option: str, value: float):
    options = MotionOptions(**{option: value})
    with pytest.raises(InputError, match=f"motion option {option}: wanted .* got {value}"):
        pose_sequence_of_names(["open", "fist"], CANONICAL, handedness=Handedness.RIGHT, options=options)


def test_minimum_jerk_starts_and_stops_at_rest():
    u = np.linspace(0, 1, 1001)
    path = minimum_jerk(u)
    speed = np.gradient(path, u)
    assert (path[0], path[-1]) == (0.0, 1.0)
    assert (np.diff(path) >= 0).all()
    assert abs(speed[0]) < 1e-4
    assert abs(speed[-1]) < 1e-4
    assert minimum_jerk(np.array([-1.0, 2.0])).tolist() == [0.0, 1.0]
