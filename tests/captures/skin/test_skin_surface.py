"""The fine surface: what bends, and what moves it."""

import numpy as np
import pytest

from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.captures.skin.maps import paint_skin
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface

LEVELS = 1


@pytest.fixture(scope="module")
def hand() -> RiggedHand:
    return RiggedHand(load_identity("adult_woman"))


@pytest.fixture(scope="module")
def surface(hand) -> SkinSurface:
    return SkinSurface(hand.identity, LEVELS, paint_skin(hand.identity, 128, Person()))


def test_a_flat_hand_is_straight_and_a_fist_is_bent_at_its_knuckles(hand, surface):
    poses = hand.pose(np.stack([hand.angles_of(name) for name in ("flat", "fist")]))
    flat, fist = surface.bent(poses.joints_m)
    rest = surface.posed(hand.identity.vertices_m, np.zeros(len(flat)))
    near = [np.argsort(np.linalg.norm(rest - hand.identity.joints_m[7 + finger], axis=1))[:20] for finger in range(4)]
    assert flat[near].max() < 0.05
    assert fist[near].min() > 0.8
    assert fist.max() <= 1
    assert flat.min() >= 0


def test_a_degree_changes_little(hand, surface):
    angles = np.repeat(hand.angles_of("flat")[None], 91, 0)
    angles[:, 1:, 2] = np.arange(91)[:, None]
    bent = surface.bent(hand.pose(angles).joints_m)
    assert np.abs(np.diff(bent, axis=0)).max() < 0.05


def test_heights_move_the_skin_outwards_and_leave_the_wrists_cut(hand, surface):
    vertices_m = hand.skin(hand.pose(hand.angles_of("flat")[None]))[0]
    count = surface.posed(vertices_m, 0.0).shape[0]
    straight, bent = (surface.posed(vertices_m, np.full(count, amount)) for amount in (0.0, 1.0))
    moved_m = np.linalg.norm(bent - straight, axis=1)
    assert 0.5e-3 < moved_m.max() < 5e-3
    assert (moved_m == 0).sum() > 20
