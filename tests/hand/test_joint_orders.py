"""Orders of joints: conversions, and the detection of a wrong order or unit."""

import numpy as np
import pytest
import torch
from hand import sampled_hands as hands
from hypothesis import given
from hypothesis import strategies as st

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, LEVEL_NAMES, PARENTS, STANDARD_NAMES
from jghand_engine.hand.orders import (
    JointOrder,
    check_hand_size,
    check_order,
    from_level,
    guess_order,
    implausibilities,
    joint_count,
    to_level,
)

ORDERS = list(JointOrder)
LISTS = {
    JointOrder.LEVEL: list(LEVEL_NAMES),
    JointOrder.STANDARD: list(STANDARD_NAMES),
    JointOrder.INTERHAND: [*(f"{finger}{k}" for finger in FINGERS for k in (4, 3, 2, 1)), "wrist"],
    JointOrder.MANO16_TIPS: [
        "wrist",
        *(f"{finger}{k}" for finger in ("index", "middle", "pinky", "ring", "thumb") for k in (1, 2, 3)),
        *(f"{finger}4" for finger in FINGERS),
    ],
    JointOrder.OPENXR: [
        "palm",
        "wrist",
        *(f"thumb{k}" for k in (1, 2, 3, 4)),
        *(name for f in FINGERS[1:] for name in (f"{f} metacarpal", f"{f}1", f"{f}2", f"{f}3", f"{f}4")),
    ],
}


@pytest.mark.parametrize("order", ORDERS)
def test_every_joint_goes_where_its_name_says(order):
    numbered = np.repeat(np.arange(len(LISTS[order]), dtype=float)[:, None], 3, axis=1)
    level = to_level(numbered, order)
    assert [LISTS[order][int(joint[0])] for joint in level] == list(LEVEL_NAMES)


@pytest.mark.parametrize("order", ORDERS)
@given(seed=st.integers(0, 2**31), batch=st.lists(st.integers(1, 3), max_size=2))
def test_there_and_back_is_exact(order, seed, batch):
    joints = np.random.default_rng(seed).standard_normal((*batch, 21, 3))
    foreign = from_level(joints, order)
    assert foreign.shape == (*batch, joint_count(order), 3)
    assert np.array_equal(to_level(foreign, order), joints)


def test_other_names_of_the_standard_order():
    for name in ("openpose", "mediapipe", "MediaPipe", "mano21", "freihand", "standard"):
        assert JointOrder.parse(name) is JointOrder.STANDARD
    assert JointOrder.parse("webxr") is JointOrder.OPENXR
    with pytest.raises(InputError, match="interhand"):
        JointOrder.parse("kinect")


def test_webxr_is_openxr_without_the_palm():
    joints = hands.canonical_np()
    assert np.array_equal(to_level(from_level(joints, JointOrder.OPENXR)[1:], JointOrder.parse("webxr")), joints)


def test_estimated_openxr_joints_lie_between_wrist_and_knuckles():
    joints = hands.canonical_np()
    foreign = dict(zip(LISTS[JointOrder.OPENXR], from_level(joints, JointOrder.OPENXR), strict=True))
    for finger in FINGERS[1:]:
        base, knuckle, wrist = foreign[f"{finger} metacarpal"], foreign[f"{finger}1"], foreign["wrist"]
        part = np.linalg.norm(base - wrist) / np.linalg.norm(knuckle - wrist)
        assert 0.3 < part < 0.4
        assert np.linalg.norm(np.cross(base - wrist, knuckle - wrist)) < 1e-15
    assert np.allclose(foreign["palm"], (foreign["middle metacarpal"] + foreign["middle1"]) / 2)


@pytest.mark.parametrize(
    ("count", "order", "says"),
    [
        (42, JointOrder.STANDARD, "two hands of InterHand2.6M"),
        (20, JointOrder.STANDARD, "One joint is missing"),
        (16, JointOrder.STANDARD, "append the five tips"),
        (26, JointOrder.STANDARD, "openxr"),
        (25, JointOrder.STANDARD, "webxr"),
        (21, JointOrder.OPENXR, "21 joints are not openxr"),
        (7, JointOrder.STANDARD, "wanted 21 joints"),
    ],
)
def test_a_wrong_number_of_joints_is_named(count, order, says):
    with pytest.raises(InputError, match=says):
        to_level(np.zeros((5, count, 3)), order)


@pytest.mark.parametrize("shape", [(21,), (21, 2), (3, 21), ()])
def test_a_wrong_shape_is_named(shape):
    with pytest.raises(InputError, match="shape"):
        to_level(np.zeros(shape), JointOrder.STANDARD)


@pytest.mark.parametrize("claimed", [order for order in ORDERS if order is not JointOrder.OPENXR])
@pytest.mark.parametrize("true", [order for order in ORDERS if order is not JointOrder.OPENXR])
def test_a_wrong_order_is_caught_and_the_right_one_named(true, claimed):
    motion = hands.sample(50, palm_m=0.001, bone=0.05).numpy()
    foreign = from_level(motion, true)
    assert guess_order(foreign) is true
    read = to_level(foreign, claimed)
    if claimed is true:
        check_order(read, claimed)
        return
    with pytest.raises(InputError, match=f"look like the order '{true}'"):
        check_order(read, claimed)


def test_swapped_or_reversed_fingers_are_caught():
    joints = hands.canonical_np().reshape(1, 21, 3)
    assert implausibilities(joints) == []
    fingers = joints[:, 1:].reshape(4, 5, 3)
    for shuffle in ([0, 1, 2, 4, 3], [0, 1, 3, 2, 4], [0, 2, 1, 3, 4], [4, 3, 2, 1, 0]):
        shuffled = np.concatenate([joints[0, :1], fingers[:, shuffle].reshape(20, 3)])
        with pytest.raises(InputError, match="no order that JGHand knows"):
            check_order(shuffled)


def test_a_thumb_that_starts_beyond_the_knuckles_is_no_thumb():
    joints = hands.canonical_np()
    joints[1] *= 3.0
    assert implausibilities(joints) == ["the thumb's first bone is longer than a metacarpal of another finger"]


@pytest.mark.parametrize(("finger", "name"), [(1, "index"), (2, "middle"), (3, "ring"), (4, "pinky")])
def test_a_second_phalanx_longer_than_the_first_is_told_of_its_own_finger(finger, name):
    joints = hands.canonical_np()
    joint = 11 + finger  # where the second phalanx ends, level order
    first, second = joints[joint - 5] - joints[joint - 10], joints[joint] - joints[joint - 5]
    joints[[joint, joint + 5]] += (1.5 * np.linalg.norm(first) / np.linalg.norm(second) - 1) * second
    assert implausibilities(joints) == [f"the second phalanx of the {name} finger is longer than its first"]


def test_the_order_does_not_depend_on_pose_place_or_unit():
    fist = hands.hand(torch.full((1, 5, 3), 1.4, dtype=torch.float64), torch.zeros(1, 5, dtype=torch.float64))
    check_order(fist.numpy() * 1000 + 5)
    frames = np.concatenate([fist.numpy(), np.full((3, 21, 3), np.nan)])
    check_order(frames)
    with pytest.raises(InputError, match="at least one frame"):
        check_order(np.full((3, 21, 3), np.nan))


@pytest.mark.parametrize(
    ("scale", "declared", "looks_like"),
    [
        (1000.0, "m", "millimeters"),
        (100.0, "m", "centimeters"),
        (1.0, "mm", "meters"),
        (10.0, "cm", None),
        (1000.0, "cm", "millimeters"),
    ],
)
def test_a_wrong_unit_is_caught_and_the_right_one_named(scale, declared, looks_like):
    per_unit = {"m": 1.0, "cm": 0.01, "mm": 0.001}[declared]
    joints_m = hands.canonical_np() * scale * per_unit
    with pytest.raises(InputError, match=f"looks like {looks_like}" if looks_like else "Check the unit"):
        check_hand_size(joints_m, declared)


@pytest.mark.parametrize("scale", [0.45, 1.0, 1.9])
def test_children_and_giants_have_a_hand_of_possible_size(scale):
    check_hand_size(hands.canonical_np() * scale)


def test_hierarchies_of_all_names_agree():
    parent_of = {LEVEL_NAMES[i]: LEVEL_NAMES[PARENTS[i]] for i in range(1, 21)}
    for finger in FINGERS:
        assert [parent_of[f"{finger}{k}"] for k in (1, 2, 3, 4)] == ["wrist", *(f"{finger}{k}" for k in (1, 2, 3))]


def test_real_hand_passes(shared_data):
    joints = np.load(shared_data / "real" / "human_joint_right.npy", allow_pickle=False)
    level = to_level(joints, JointOrder.parse("mediapipe"))
    check_order(level, JointOrder.STANDARD)
    check_hand_size(level)
    assert guess_order(joints) is JointOrder.STANDARD
    with pytest.raises(InputError, match="look like the order 'standard'"):
        check_order(to_level(joints, JointOrder.INTERHAND), JointOrder.INTERHAND)
