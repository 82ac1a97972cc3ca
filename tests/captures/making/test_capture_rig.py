"""The hands that captures show and the rig that poses them."""

import numpy as np
import pytest
import torch

from jghand_engine.avatar.avatar import FOREARM_WAY
from jghand_engine.captures.making.plan import wrist_turns
from jghand_engine.captures.making.rig import RiggedHand, RigPose, identity_names, load_identity
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.kinematics import TIP_THICKNESS_PART
from jghand_engine.hand.orders import bone_lengths, check_hand_size, check_order
from jghand_engine.hand.shapes import pose_names
from jghand_engine.hand.skeleton import Skeleton
from jghand_engine.hand.wrist import slice_shares
from jghand_engine.template.builtin import load_template
from jghand_engine.template.mesh import skinned
from jghand_engine.template.surface import is_closed


@pytest.fixture(scope="module")
def hand() -> RiggedHand:
    return RiggedHand(load_identity("adult_woman"))


@pytest.fixture(scope="module")
def named(hand) -> RigPose:
    return hand.pose(np.stack([hand.angles_of(name) for name in pose_names()]))


@pytest.mark.parametrize("name", identity_names())
def test_every_identity_is_a_hand_that_is_not_the_template(name):
    identity, template = load_identity(name), load_template()
    check_order(identity.joints_m)
    check_hand_size(identity.joints_m)
    assert is_closed(identity.faces)
    assert np.abs(identity.weights25.sum(1) - 1).max() < 1e-12
    # the nearest of them, old_person, differs by 4.1 mm on average where both are laid wrist on wrist
    assert np.linalg.norm(identity.vertices_m - template.vertices_m, axis=1).mean() > 3e-3


def test_an_identity_has_a_number_and_a_name():
    assert load_identity("3").name == load_identity("adult_man").name == "adult_man"


@pytest.mark.parametrize("wanted", ["99", "nobody", "", "-1"])
def test_an_unknown_identity_is_told_with_those_that_there_are(wanted):
    with pytest.raises(InputError, match="3 adult_man"):
        load_identity(wanted)


def test_the_rest_pose_moves_nothing(hand):
    rest = hand.identity.joints25_m
    still = RigPose(np.tile(np.eye(3), (1, 25, 1, 1)), rest[None])
    # worst observed 3e-17 m
    np.testing.assert_allclose(hand.skin(still)[0], hand.identity.vertices_m, atol=1e-15)


def test_fingers_keep_their_bone_lengths_in_every_pose(hand, named):
    wanted = bone_lengths(hand.identity.joints_m)
    got = bone_lengths(named.joints_m)
    # thumb and phalanges; index to pinky metacarpals reach from the wrist, and the palm cups between. Observed 3e-17 m
    np.testing.assert_allclose(got[:, 5:], np.tile(wanted[5:], (len(got), 1)), atol=1e-15)
    np.testing.assert_allclose(got[:, 0], wanted[0], atol=1e-15)


def test_the_palm_cups_in_a_fist_and_flattens_when_fingers_stretch(hand):
    """The metacarpals of ring and pinky move: what no hand of 21 joints can follow exactly."""
    angles = np.zeros((2, 5, 4))
    angles[0, 1:, 0], angles[1, 1:, 0] = 85, -20
    fist, stretched = hand.pose(angles).joints_m[:, 5] - hand.identity.joints_m[5]
    assert fist[2] > 3e-3
    assert stretched[2] < 0


def test_the_gap_to_the_template_that_is_fitted_is_more_than_a_millimeter(hand, named):
    """No inverse crime: the built-in hand, driven by our transform with the exact joints, is not the captured skin."""
    template = load_template()
    gap_m = _driven_gap_m(template.vertices_m, template.bone_weights, template.joints_m, hand, named)
    # observed 1.4 mm
    assert gap_m.mean() > 1e-3


def test_even_with_the_captures_own_shape_our_transform_does_not_give_its_skin(hand, named):
    """Shape, canonical joints and exact joints are known here, as nobody's fit knows them; the rig is still another."""
    identity = hand.identity
    gap_m = _driven_gap_m(identity.vertices_m, identity.bone_weights, identity.joints_m, hand, named)
    # observed mean 0.47 mm
    assert gap_m.mean() > 3e-4
    assert gap_m.max() > 4e-3


def _driven_gap_m(vertices_m, weights, canonical_m, hand: RiggedHand, pose: RigPose) -> np.ndarray:
    """(F, V) distance of what our transform makes of a shape with the rig's exact joints from the rig's skin."""
    skeleton = Skeleton(canonical_m, handedness=Handedness.RIGHT)
    driven = np.stack([skinned(vertices_m, weights, skeleton, joints) for joints in pose.joints_m])
    return np.linalg.norm(driven - hand.skin(pose), axis=-1)


def test_thumb_and_index_touch_in_a_pinch_although_the_palm_cups(hand):
    joints = hand.joints(hand.angles_of("pinch")[None])[0]
    # the tips' joints are apart by what is between them and the skin: observed 0.3 mm from that
    assert abs(np.linalg.norm(joints[16] - joints[17]) - TIP_THICKNESS_PART * hand.finger_length_m) < 1e-3


def test_following_its_own_joints_gives_the_pose_again(hand, named):
    followed = hand.follow(named.joints_m)
    # worst observed 3.2 mm: the cup of the palm is guessed from the fingers
    assert np.linalg.norm(followed.joints_m - named.joints_m, axis=-1).max() < 4e-3


def test_a_followed_hand_points_the_same_way_whatever_its_size(hand, named):
    turn = torch.linalg.qr(torch.from_numpy(np.random.default_rng(3).normal(size=(3, 3))))[0].numpy()
    turn *= np.linalg.det(turn)
    foreign = 1.3 * named.joints_m @ turn.T + [0.1, -0.2, 0.3]
    followed = hand.follow(foreign).joints_m
    wanted, got = (_directions(joints) for joints in (foreign, followed))
    # finger bones take their direction exactly; observed 1e-12
    np.testing.assert_allclose(got, wanted, atol=1e-10)
    upright = hand.follow(foreign, upright=True).joints_m
    # as a whole it is back in the canonical frame, but for what the palm's cup turns it; observed 1e-3
    np.testing.assert_allclose(_directions(upright), _directions(named.joints_m), atol=0.08)


def test_the_forearm_turned_as_it_is_said_lies_where_the_rig_has_it(named):
    """Behind where it twists: of one shape, whatever way it turns with the hand."""
    hand = RiggedHand(load_identity("adult_woman", forearm=True))
    identity, turns = hand.identity, wrist_turns(len(named.turn), 25, seed=5)
    pose = named.moved(turns, identity.joints_m[0] + [0.0, 0.08, 0.0])
    shares = slice_shares((identity.vertices_m - identity.joints_m[0]) @ FOREARM_WAY)
    end = shares[:, -1] == 1
    weights = np.concatenate([identity.bone_weights[end], identity.bone_weights[end, :1] * shares[end]], 1)
    skeleton = Skeleton(identity.joints_m, handedness=Handedness.RIGHT, forearm_way=FOREARM_WAY)
    skin_m, said = hand.skin(pose)[:, end], hand.forearm(pose)

    def gaps_m(forearm):
        driven = (
            skinned(identity.vertices_m[end], weights, skeleton, *of) for of in zip(pose.joints_m, forearm, strict=True)
        )
        return np.linalg.norm(np.stack(list(driven)) - skin_m, axis=-1)

    # worst observed 0.37 mm: the hand's size is told by its bones, some of which are shorter in an arched palm. Turned
    # the other way it is off by 28 mm, and as the palm carries it by 14 mm
    assert gaps_m(said).max() < 5e-4
    assert gaps_m([None] * len(said)).max() > 1e-2


def _directions(joints: np.ndarray) -> np.ndarray:
    bones = joints[:, 6:] - joints[:, 1:16]
    return bones / np.linalg.norm(bones, axis=-1, keepdims=True)


def test_a_whole_turn_moves_joints_and_skin_as_one_body(hand, named):
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    center = np.array([0.0, 0.08, 0.0])
    moved = named.moved(np.broadcast_to(turn, (len(named.turn), 3, 3)), center)
    expected = (hand.skin(named) - center) @ turn.T + center
    # observed 1e-16 m
    np.testing.assert_allclose(hand.skin(moved), expected, atol=1e-14)
    np.testing.assert_allclose(moved.joints_m, (named.joints_m - center) @ turn.T + center, atol=1e-14)
