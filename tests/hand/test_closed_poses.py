"""Fingers that close: a palm that arches, tips that lie on it, a thumb that rests on fingers; all by bones."""

import numpy as np
import pytest
from hand import sampled_hands as hands

from jghand_engine.captures.making.rig import load_identity
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import (
    ARCH_FLEXIONS_DEG,
    BESIDE_PARTS,
    PALM_GAP_PARTS,
    RANGES_DEG,
    REST_PART,
    ArchingHand,
    ArticulatedHand,
    Fist,
    palm_gaps_m,
    segment_gap,
)
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import POSES_DEG, angles_on
from jghand_engine.template.builtin import load_template

CANONICAL = hands.canonical_np()


@pytest.fixture(scope="module")
def hand() -> ArchingHand:
    return ArchingHand(load_template().joints_m)


def test_knuckles_draw_together_and_sink_as_fingers_close(hand):
    still, closed = hand.straight_joints_m, named_pose("fist", hand.straight_joints_m, handedness=Handedness.RIGHT)

    def from_middle_m(joints: np.ndarray) -> np.ndarray:
        return np.linalg.norm((joints[2:6] - joints[3])[:, :2], axis=1)

    # index 2 mm, ring 2 and pinky 5 nearer, seen onto the palm
    nearer_m = from_middle_m(still) - from_middle_m(closed)
    assert (nearer_m[[0, 2, 3]] > [1.5e-3, 1e-3, 4e-3]).all()
    sunk_m = (closed - still)[2:6] @ hand.palm_normal
    assert (sunk_m[2:] > [1e-3, 5e-3]).all()
    np.testing.assert_array_equal(closed[3], still[3])


def test_a_palm_arches_smoothly_and_not_before_fingers_are_half_bent(hand):
    flexion = np.linspace(*RANGES_DEG[1, 0], 400)
    angles = np.zeros((400, 5, 4))
    angles[:, 1:, 0] = flexion[:, None]
    knuckles_m = hand.joints(angles)[:, 2:6]
    early = flexion <= ARCH_FLEXIONS_DEG[0]
    np.testing.assert_allclose(knuckles_m[early], np.broadcast_to(hand.straight_joints_m[2:6], (early.sum(), 4, 3)))
    speed = np.diff(knuckles_m, axis=0)
    # of the pinky's 12 mm in 45 degrees, 0.1 mm between neighbors
    assert np.linalg.norm(np.diff(speed, axis=0), axis=-1).max() < 2e-5


def test_an_arch_turns_with_the_hand():
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    turned = named_pose("fist", CANONICAL @ turn.T + 0.3, handedness=Handedness.RIGHT)
    np.testing.assert_allclose(
        turned, named_pose("fist", CANONICAL, handedness=Handedness.RIGHT) @ turn.T + 0.3, atol=1e-9
    )


def test_finger_tips_lie_on_the_palm_of_a_fist_and_not_in_it(hand):
    gaps_m = palm_gaps_m(hand.joints(angles_on(hand, "fist")[None]))[0]
    np.testing.assert_allclose(gaps_m, hand.finger_length_m * np.array(PALM_GAP_PARTS), atol=3e-4)
    # the table of angles alone runs into the palm
    assert palm_gaps_m(hand.joints(np.array(POSES_DEG["fist"])[None])).min() < 3e-3


FIST = Fist((1.0, 2.0, 4.0), (0.01, -0.01, 0.005))


@pytest.mark.parametrize(
    ("name", "wanted_deg"),
    [
        ("fist", (1, 0, 2, 6)),
        ("call", (1, 0, 2, 0)),  # the pinky is straight
        ("victory", (0, 0, 0, 4)),  # so is the middle finger, and the pinky follows a ring finger that does not turn
        ("point", (0, 0, 2, 6)),
        ("three", (0, 0, 0, 0)),
        ("open", (0, 0, 0, 0)),
        ("grasp", (0, 0, 0, 0)),
    ],
)
def test_fingers_turn_as_skin_wants_where_they_and_their_neighbors_are_those_of_a_fist(name, wanted_deg):
    by_bones, by_skin = (angles_on(ArchingHand(CANONICAL, fist), name)[1:, 1] for fist in (Fist(), FIST))
    np.testing.assert_allclose(by_skin - by_bones, wanted_deg, atol=1e-12)


def test_tips_go_as_far_into_the_palm_as_skin_wants():
    hand = ArchingHand(load_template().joints_m, FIST)
    gaps_m = palm_gaps_m(hand.joints(angles_on(hand, "fist")[None]))[0]
    parts = np.add(PALM_GAP_PARTS, (0, *FIST.room_parts))
    np.testing.assert_allclose(gaps_m, hand.finger_length_m * parts, atol=3e-4)


@pytest.mark.parametrize(("thumb", "finger", "part"), [(11, 8, REST_PART), (6, 7, BESIDE_PARTS[0])])
def test_a_thumb_lies_as_far_from_fingers_as_skin_wants(thumb, finger, part):
    """Its last bone from the middle finger on which it rests, and the bone before from the index finger."""
    canonical_m = load_identity("long_fingers").joints_m
    size_m, gaps = ArchingHand(canonical_m).finger_length_m, []
    for fist in (Fist(), Fist(thumb_part=0.01)):
        joints = named_pose("fist", canonical_m, handedness=Handedness.RIGHT, fist=fist)
        bones = ((joints[first], joints[first + 5]) for first in (finger, finger + 5))
        gaps.append(min(segment_gap(joints[thumb], joints[thumb + 5], *bone) for bone in bones) / size_m)
    # the last bits of air are not closed (`TOUCH_PULL_DEG`): worst seen 4e-4
    np.testing.assert_allclose(gaps, [part, part + 0.01], atol=1e-3)


def test_fingers_that_are_not_in_the_palm_stay_as_they_are(hand):
    for name in ("open", "claw", "grasp", "table"):
        angles = np.array(POSES_DEG[name], np.float64)
        np.testing.assert_array_equal(hand.eased(angles), angles)


def test_a_hand_whose_palm_does_not_arch_keeps_its_knuckles():
    joints = ArticulatedHand(CANONICAL).joints(np.array(POSES_DEG["fist"])[None])[0]
    np.testing.assert_allclose(joints[:6], CANONICAL[:6], atol=1e-15)


def test_the_gap_between_segments_is_that_of_their_nearest_points():
    random = np.random.default_rng(0)
    ends = random.normal(size=(4, 200, 3))
    steps = np.linspace(0, 1, 80)
    first = ends[0][:, None] + steps[:, None] * (ends[1] - ends[0])[:, None]
    second = ends[2][:, None] + steps[:, None] * (ends[3] - ends[2])[:, None]
    searched = np.linalg.norm(first[:, :, None] - second[:, None], axis=-1).min((1, 2))
    found = segment_gap(*ends)
    # never nearer than there is; near enough after few rounds (worst observed 0.11 of unit segments)
    assert (found > searched - 0.05).all()
    assert np.abs(found - searched).mean() < 0.02
