"""The poses of a capture: inside the ranges, varied from the first on, and nothing runs through the hand."""

import numpy as np
import pytest

from jghand_engine.captures.making import poses as making_poses
from jghand_engine.captures.making.poses import (
    contact_poses,
    extreme_poses,
    gap_m,
    letter_poses,
    named_poses,
    random_poses,
    varied_poses,
)
from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.errors import InputError
from jghand_engine.hand.kinematics import RANGES_DEG, TIP_THICKNESS_PART, Contact
from jghand_engine.hand.shapes import LETTER_CONTACTS, pose_names

LOW, HIGH = RANGES_DEG[..., 0], RANGES_DEG[..., 1]
ROUND_OFF_DEG = 1e-9


@pytest.fixture(scope="module")
def hand() -> RiggedHand:
    return RiggedHand(load_identity("adult_woman"))


@pytest.fixture(scope="module")
def poses(hand):
    return varied_poses(hand, 60, seed=0)


def test_all_angles_stay_in_the_ranges_of_hands(poses):
    assert (poses.angles_deg >= LOW - ROUND_OFF_DEG).all()
    assert (poses.angles_deg <= HIGH + ROUND_OFF_DEG).all()


def test_no_pose_comes_twice(poses):
    assert len(set(poses.names)) == len(poses) == 60


def test_the_same_seed_gives_the_same_poses_and_another_seed_others(hand, poses):
    np.testing.assert_array_equal(varied_poses(hand, 60, seed=0).angles_deg, poses.angles_deg)
    assert not np.array_equal(varied_poses(hand, 60, seed=1).angles_deg, poses.angles_deg)


@pytest.mark.parametrize("count", [12, 24, 48])
def test_every_prefix_is_varied(poses, count):
    """Each kind has its share, and the angles reach over most of what the whole set reaches over."""
    names = poses.names[:count]
    kinds = {
        "named": sum(name in pose_names() for name in names),
        "letters": sum(name.startswith("letter_") for name in names),
        "transitions": sum("_to_" in name for name in names),
        "random": sum(name.startswith("random_") for name in names),
        "contacts": sum(name.startswith(("touch_", "rest_on_")) for name in names),
    }
    assert min(kinds.values()) >= count // 6 - 1, kinds
    reach = np.ptp(poses.angles_deg[:count], axis=0) / np.ptp(poses.angles_deg, axis=0)
    # worst observed 0.53 for 12 poses, 0.72 for 24
    assert reach.mean() > 0.75


def test_extremes_reach_both_ends():
    angles = extreme_poses().angles_deg
    part = (angles - LOW) / (HIGH - LOW)
    # flexion of the fingers, and their spread
    assert part[:, 1:, [0, 2]].max((0, 1)).min() > 0.9
    assert part[:, 1:, [0, 2]].min((0, 1)).max() < 0.1
    assert part[:, 1:, 1].max(0).min() > 0.9


def test_fingers_of_random_poses_stay_apart(hand, poses):
    joints = hand.joints(poses.angles_deg)
    random = [k for k, name in enumerate(poses.names) if name.startswith("random_") or "_to_" in name]
    assert gap_m(joints[random]).min() > 0.0105


def test_bending_the_middle_joint_brings_the_last_one_along():
    angles = random_poses(400, np.random.default_rng(0)).angles_deg
    pip, dip = angles[:, 1:, 2].ravel(), angles[:, 1:, 3].ravel()
    assert np.corrcoef(pip, dip)[0, 1] > 0.9


@pytest.mark.parametrize("kind", [letter_poses, contact_poses, named_poses])
def test_thumbs_reach_what_they_should_touch(hand, kind):
    poses = kind(hand)
    joints = dict(zip(poses.names, hand.joints(poses.angles_deg), strict=True))
    wanted = {
        f"letter_{letter.lower()}": finger
        for letter, (how, finger) in LETTER_CONTACTS.items()
        if how is Contact.TIP and finger < 3
    }
    wanted |= {"touch_index_open": 1, "touch_index_relaxed": 1, "touch_middle_open": 2, "pinch": 1, "ok": 1}
    for name, finger in wanted.items():
        if name in joints:
            # the tips' joints are apart by what is between them and the skin: observed 0.13 mm from that
            distance = np.linalg.norm(joints[name][16] - joints[name][16 + finger])
            assert abs(distance - TIP_THICKNESS_PART * hand.finger_length_m) < 1e-3, name


@pytest.mark.parametrize("count", [0, -1, 100_000])
def test_an_impossible_number_of_poses_is_refused(hand, count):
    with pytest.raises(InputError, match="poses of a capture"):
        varied_poses(hand, count, seed=0)


def test_more_poses_than_a_hand_has_are_refused_instead_of_sought_for_ever(hand, monkeypatch):
    monkeypatch.setattr(making_poses, "CANDIDATES", 0)
    monkeypatch.setattr(making_poses, "CANDIDATES_LEAST", 1)
    with pytest.raises(InputError, match="at most the"):
        varied_poses(hand, 300, seed=0)
