"""Skin that nearly touches touches, on every hand, and none is inside another."""

import numpy as np
import pytest
from show_skin_gaps import driven_gaps

from jghand_engine.captures.making.closing import Closing
from jghand_engine.captures.making.rig import RiggedHand, identity_names, load_identity
from jghand_engine.captures.making.skin_gaps import IdentitySkin
from jghand_engine.hand.kinematics import RANGES_DEG


@pytest.fixture(scope="module")
def woman() -> Closing:
    return Closing(RiggedHand(load_identity("adult_woman")))


@pytest.mark.parametrize("name", identity_names())
def test_a_fist_is_closed_on_every_hand(name):
    closing = Closing(RiggedHand(load_identity(name)))
    angles = closing.closed(closing.hand.angles_of("fist"))
    assert (angles >= RANGES_DEG[..., 0]).all()
    assert (angles <= RANGES_DEG[..., 1]).all()
    gaps = closing.gaps(angles)
    # by the bones alone neighbors are up to 7 mm apart; worst observed 0.4
    assert gaps.neighbors().min() > -1
    assert gaps.neighbors().max() < 0.5
    # worst observed -2.7 and -1.2; the web beside the thumb of the long fingers is thin, and their index comes through
    assert gaps.palm().min() > (-5 if name == "long_fingers" else -4)
    assert gaps.palm().max() < 0
    # the whole thumb lies on the index finger, and on the middle one where it is long enough
    # worst observed 0.7 and 1.9: on a big and an old hand its joints are bent as far as they go
    assert -2 < gaps.thumb()[0] < 1
    assert -4 < gaps.thumb()[1] < 2.5


@pytest.mark.parametrize("name", identity_names())
def test_a_named_fist_is_closed_on_an_avatar_of_every_hand(name):
    gaps = driven_gaps(RiggedHand(load_identity(name)), "fist")
    # worst observed -0.3 and 0; without the fist of its skin -1.9 and 0.8
    assert gaps.neighbors().min() > -0.5
    assert gaps.neighbors().max() < 0.2
    # worst observed -1.4 and -0.6 of middle to pinky, and -4.2 of the index finger, which meets the ball of the thumb
    assert gaps.palm()[1:].min() > -1.6
    assert gaps.palm().max() < -0.4
    assert gaps.palm()[0] > -4.5
    # worst observed -0.7 and 2.6; -5.8 and 9.1 with a thumb that makes for the middle finger alone
    assert -1 < gaps.thumb()[0] < 1
    assert -1 < gaps.thumb()[1] < 3


@pytest.mark.parametrize("name", identity_names())
def test_a_named_pinch_touches_skin_on_skin_on_an_avatar_of_every_hand(name):
    # worst observed -0.9 and 0.8; -4.6 where the joints of the tips meet
    assert abs(driven_gaps(RiggedHand(load_identity(name)), "pinch").thumb()[0]) < 1


@pytest.mark.parametrize("name", ["pinch", "ok"])
def test_thumb_and_index_touch_skin_on_skin(woman, name):
    assert -1 < woman.gaps(woman.closed(woman.hand.angles_of(name))).thumb()[0] < 0


@pytest.mark.parametrize("name", ["open", "spread", "claw", "table"])
def test_a_pose_in_which_nothing_nearly_touches_stays(woman, name):
    angles = woman.hand.angles_of(name)
    np.testing.assert_array_equal(woman.closed(angles), angles)


def test_a_finger_moved_by_a_millimeter_is_a_millimeter_nearer():
    """What the measure says changes as the skin moves, outside and inside."""
    identity = load_identity("adult_woman")
    skin, hand = IdentitySkin(identity), RiggedHand(identity)
    posed_m = hand.skin(hand.pose(hand.angles_of("flat")[None]))[0]
    # of the whole index finger to the middle one
    to_middle_m = -1e-3 * identity.weights25[:, 6:10].sum(1)[:, None] * [1.0, 0.0, 0.0]

    def gap(moved_mm: float) -> float:
        return float(skin.gaps(posed_m + moved_mm * to_middle_m).neighbors()[0])

    start = gap(0)
    moves = np.arange(1, start + 6)
    seen = np.array([gap(move) for move in moves])
    # flanks are round and not parallel: observed 0.6 to 1.0 mm for each millimeter
    assert (np.diff(seen) < -0.4).all()
    assert (np.diff(seen) > -1.3).all()
    assert seen[-1] < 0
