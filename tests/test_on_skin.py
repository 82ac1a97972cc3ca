"""Gaussians of a forearm that lie beside the skin of its person are put there, in every pose, and get its colors."""

from dataclasses import replace

import numpy as np
import on_skin
import pytest
from other_person import Somebody, somebody
from test_other_person import painted

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.posing import Posing
from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.template.closest import Surface

ASIDE_M = np.array([0.0, 0.0, 0.006])


def behind_m(avatar: HandAvatar) -> np.ndarray:
    return (avatar.position_m - avatar.canonical_joints_m[0]) @ FOREARM_WAY


@pytest.fixture(scope="module")
def one() -> Somebody:
    return somebody(load_builtin(handedness=Handedness.RIGHT), "adult_woman", Person(), painted(0, 0.5))


@pytest.fixture(scope="module")
def hands(one) -> tuple[HandAvatar, HandAvatar]:
    """One whose forearm lies aside and is black, and the same after fewer steps than hands that are shipped."""
    hand = load_builtin(handedness=Handedness.RIGHT).prefix(3000)
    far = behind_m(hand) > on_skin.TO_M
    moved = replace(
        hand,
        position_m=np.where(far[:, None], hand.position_m + ASIDE_M, hand.position_m).astype(np.float32),
        rgb=np.where(far[:, None], 0.01, hand.rgb).astype(np.float32),
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(on_skin, "POSES", 12)
        patch.setattr(on_skin, "STEPS", 200)
        return moved, on_skin.on_skin(moved, one)


def depths_mm(avatar: HandAvatar, one: Somebody, name: str) -> np.ndarray:
    """(N,) of Gaussians, above the skin positive."""
    hand, surface = RiggedHand(one.identity), SkinSurface(one.identity, 1, one.maps)
    posed = hand.pose(hand.angles_of(name)[None])
    skin_m = surface.posed(hand.skin(posed)[0], surface.bent(posed.joints_m)[0])
    skin = Surface(skin_m, surface.faces[: 4 * one.identity.skin_face_count])
    place_m = Posing(avatar)(posed.joints_m[0], hand.forearm(posed)[0]).position_m.astype(np.float64)
    near = skin.closest(place_m)
    return 1e3 * ((place_m - near.point_m) * skin.normals(near.face, near.barycentric)).sum(1)


@pytest.mark.parametrize("name", ["open", "fist"])
def test_a_forearm_is_put_on_its_skin_in_poses_that_it_was_not_fitted_to(hands, one, name):
    far = (behind_m(hands[1]) > on_skin.TO_M) & (behind_m(hands[1]) < 0.11)
    assert far.sum() > 100
    before, after = (depths_mm(hand, one, name)[far] for hand in hands)
    # all as deep as those of the hand: observed spreads of 0.3 to 0.4 mm, before 12
    assert np.ptp(np.quantile(after, [0.1, 0.9])) < 1.5 < np.ptp(np.quantile(before, [0.1, 0.9]))
    assert -2.5 < np.median(after) < -0.5


def test_the_hand_before_the_wrist_stays(hands, one):
    near = behind_m(hands[0]) < on_skin.FROM_M
    before, after = (depths_mm(hand, one, "relaxed")[near] for hand in hands)
    assert np.quantile(np.abs(after - before), 0.9) < 0.8


def test_a_forearm_gets_the_color_of_the_maps(hands):
    far = behind_m(hands[0]) > on_skin.TO_M
    usual = np.median(hands[0].rgb[~far], 0)
    assert hands[0].rgb[far].max() < 0.02
    np.testing.assert_allclose(np.median(hands[1].rgb[far], 0), usual, rtol=0.4)
    np.testing.assert_array_equal(
        hands[1].rgb[~far & (behind_m(hands[0]) < 0)], hands[0].rgb[~far & (behind_m(hands[0]) < 0)]
    )


def test_a_hand_of_unknown_light_is_refused(hands, one):
    learned = hands[0].learned
    assert learned is not None
    with pytest.raises(InputError, match="known light"):
        on_skin.on_skin(replace(hands[0], learned=replace(learned, response=None)), one)
