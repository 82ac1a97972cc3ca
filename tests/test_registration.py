"""The surface of a detail lies on the skin of the person whom its hand shows, at rest and in poses."""

from dataclasses import replace

import numpy as np
import pytest
import registration
from detail_reference import posed_surface
from other_person import Somebody, somebody
from test_other_person import painted

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness

AVATAR = load_builtin(handedness=Handedness.RIGHT).prefix(10)


def of_adult(avatar: HandAvatar = AVATAR) -> Somebody:
    """The person whom the built-in hand learned, without relief."""
    return somebody(avatar, "adult_woman", Person(), painted(0, 0.5))


def apart_mm(avatar: HandAvatar, one: Somebody, name: str, levels: int) -> np.ndarray:
    """Of the vertices of the detail from where the person's skin has them, in a named pose."""
    hand, surface = RiggedHand(one.identity), SkinSurface(one.identity, levels, one.maps)
    posed = hand.pose(hand.angles_of(name)[None])
    skin_m = surface.posed(hand.skin(posed)[0], surface.bent(posed.joints_m)[0])
    surface_m, _ = posed_surface(avatar, posed.joints_m[0])
    return 1e3 * np.linalg.norm(surface_m - skin_m[: len(surface_m)], axis=1)[np.unique(avatar.detail.faces)]


def test_registered_detail_follows_the_skin_of_poses_that_it_was_not_fitted_to(monkeypatch):
    monkeypatch.setattr(registration, "POSES", 40)
    monkeypatch.setattr(registration, "LEVELS", 1)
    child = replace(of_adult(), identity=somebody(AVATAR, "child", Person(), painted(0, 0.5)).identity)
    plain = replace(AVATAR, detail=replace(AVATAR.detail, correctives=None))
    on_skin = registration.registered(plain, child)
    for name in ("pinch", "point"):
        before, after = (np.median(apart_mm(one, child, name, 1)) for one in (plain, on_skin))
        # observed: 0.04 and 0.10, of 1.25 and 1.23
        assert after < 0.15
        assert before > 1


@pytest.mark.parametrize("name", ["open", "fist", "pinch"])
def test_the_built_in_hands_detail_lies_on_the_skin_of_its_person(name):
    # most of it is the relief, which is left out here. Observed: 0.21 to 0.29; as it was learned, 1.0 to 1.4
    assert np.median(apart_mm(AVATAR, of_adult(), name, 2)) < 0.4


def test_a_hand_without_detail_is_refused():
    with pytest.raises(InputError, match="detail"):
        registration.registered(replace(AVATAR, detail=None), of_adult())
