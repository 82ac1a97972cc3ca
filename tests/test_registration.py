"""The surface of a detail lies on the skin of the person whom its hand shows, at rest and in poses."""

from dataclasses import replace

import numpy as np
import pytest
import registration
from detail_reference import posed_surface
from other_person import Somebody, somebody
from scipy.spatial import ConvexHull, KDTree
from test_other_person import painted

from jghand_engine.avatar.avatar import FOREARM_WAY, HandAvatar
from jghand_engine.avatar.builtin import load_avatar_called, load_builtin
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.posing import Posing
from jghand_engine.captures.making.rig import RiggedHand
from jghand_engine.captures.skin.person import Person
from jghand_engine.captures.skin.surface import SkinSurface
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.render.detail import FADE_TO_M, DetailedHand
from jghand_engine.template.subdivision import Subdivision

AVATAR = load_builtin(handedness=Handedness.RIGHT).prefix(10)


def surface_of(avatar: HandAvatar) -> Detail:
    assert avatar.detail is not None
    return avatar.detail


def of_adult(avatar: HandAvatar = AVATAR) -> Somebody:
    """The person whom the built-in hand learned, without relief."""
    return somebody(avatar, "adult_woman", Person(), painted(0, 0.5))


def apart_mm(avatar: HandAvatar, one: Somebody, name: str, levels: int) -> np.ndarray:
    """Of the vertices of the detail from where the person's skin has them, in a pose of the rig."""
    hand, surface = RiggedHand(one.identity), SkinSurface(one.identity, levels, one.maps)
    posed = hand.pose(hand.angles_of(name)[None])
    skin_m = surface.posed(hand.skin(posed)[0], surface.bent(posed.joints_m)[0])
    bones = avatar.skeleton().bones(posed.joints_m[0], np.float64, forearm=hand.forearm(posed)[0])
    surface_m = DetailedHand.of(avatar, 1.0).posed_m(bones)
    shown = np.unique(surface_of(avatar).faces)
    return 1e3 * np.linalg.norm(surface_m - skin_m[: len(surface_m)], axis=1)[shown]


def behind_m(avatar: HandAvatar) -> np.ndarray:
    """(V,) how far behind the wrist the detail's vertices lie at rest."""
    return (surface_of(avatar).position_m - avatar.canonical_joints_m[0]) @ FOREARM_WAY


@pytest.fixture(scope="module")
def child() -> Somebody:
    return somebody(AVATAR, "child", Person(), painted(0, 0.5))


@pytest.fixture(scope="module")
def registered_child(child) -> tuple[HandAvatar, HandAvatar]:
    """Before and after, with fewer poses and a coarser skin than hands that are shipped."""
    plain = replace(AVATAR, detail=replace(surface_of(AVATAR), correctives=None, ends_hand=False))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registration, "POSES", 40)
        patch.setattr(registration, "LEVELS", 2)
        return plain, registration.registered(plain, child)


def test_a_coarse_mesh_cuts_as_much_off_a_finer_surface_as_it_adds():
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) / np.sqrt(3)
    ball = ConvexHull(corners)
    faces = np.array([f if np.linalg.det(corners[f]) > 0 else f[::-1] for f in ball.simplices])
    coarse, fine = (Subdivision.of(faces, np.zeros((len(faces), 3, 2)), levels) for levels in (2, 3))
    round_ = (fine.matrix @ corners) / np.linalg.norm(fine.matrix @ corners, axis=1, keepdims=True)
    on_vertices = round_[: coarse.faces.max() + 1]
    fitted = registration._closest(coarse.faces)(round_)
    # the middles of a triangle's edges stand for it: their mean is that of all that a parabola cuts off
    ends = coarse.faces, np.roll(coarse.faces, -1, 1)
    before, after = (1 - np.linalg.norm((v[ends[0]] + v[ends[1]]) / 2, axis=-1) for v in (on_vertices, fitted))
    assert before.mean() > 0.01
    assert abs(after.mean()) < 0.3 * before.mean()


@pytest.mark.parametrize("name", ["pinch", "point"])
def test_registered_detail_follows_the_skin_of_poses_that_it_was_not_fitted_to(child, registered_child, name):
    before, after = (np.quantile(apart_mm(one, child, name, 1), [0.5, 0.95]) for one in registered_child)
    # observed: 0.04 and 0.10, at most 0.30; before 1.13 and 1.16
    assert after[0] < 0.15
    assert after[1] < 0.6
    assert before[0] > 1


def test_a_hand_ends_with_its_registered_detail(registered_child):
    assert [surface_of(one).ends_hand for one in registered_child] == [False, True]


@pytest.mark.parametrize("name", ["open", "fist", "pinch"])
def test_the_built_in_hands_detail_lies_on_the_skin_of_its_person(name):
    middle, most = np.quantile(apart_mm(AVATAR, of_adult(), name, 2), [0.5, 0.95])
    # most of it is the relief, which is left out here. Observed: 0.22 to 0.30, 0.74 to 0.96
    assert middle < 0.4
    assert most < 1.2


@pytest.mark.parametrize("hand", ["builtin", "strong"])
def test_nothing_is_moved_in_the_hand_at_rest(hand):
    avatar = load_avatar_called(hand)
    resting = replace(avatar, detail=replace(surface_of(avatar), correctives=None))
    moved_m = posed_surface(avatar, avatar.canonical_joints_m)[0] - posed_surface(resting, avatar.canonical_joints_m)[0]
    assert np.abs(moved_m).max() < 1e-6


@pytest.mark.parametrize("name", ["open", "fist"])
@pytest.mark.parametrize("hand", ["builtin", "strong"])
def test_gaussians_are_near_enough_for_detail_on_hand_and_forearm(hand, name):
    avatar = load_avatar_called(hand).for_hand(Handedness.RIGHT)
    joints_m = named_pose(name, avatar.rest_joints_m, handedness=Handedness.RIGHT)
    surface_m, scale = posed_surface(avatar, joints_m)
    apart_m = KDTree(Posing(avatar)(joints_m).position_m).query(surface_m)[0] / scale
    behind = behind_m(avatar)
    shown = np.isin(np.arange(len(surface_m)), surface_of(avatar).faces)
    for part in (behind < 0, (behind > 0) & (behind < 0.1)):
        # detail is gone FADE_TO_M from the depth at which they usually are. Observed: 1.8 to 3.2 mm
        assert np.quantile(apart_m[part & shown], 0.95) < FADE_TO_M + surface_of(avatar).depth_m


def test_another_mesh_is_refused(child):
    other = replace(AVATAR, detail=replace(surface_of(AVATAR), faces=surface_of(AVATAR).faces[::-1].copy()))
    with pytest.raises(InputError, match="mesh of child"):
        registration.registered(other, child)


def test_a_hand_without_detail_is_refused():
    with pytest.raises(InputError, match="detail"):
        registration.registered(replace(AVATAR, detail=None), of_adult())


def test_gaussians_grow_where_the_skin_would_have_no_color_and_nowhere_else(monkeypatch):
    monkeypatch.setattr(registration, "pose_names", lambda: ("open", "fist"))
    hand = load_builtin(handedness=Handedness.RIGHT)
    is_small = np.arange(len(hand)) % 7 == 0
    small = replace(hand, sigma_m=np.where(is_small, 1e-4, hand.sigma_m).astype(np.float32))
    grown = registration.reaching_skin(small)
    assert (grown.sigma_m >= small.sigma_m).all()
    assert 0.005 < (grown.sigma_m > small.sigma_m).mean() < 0.05, "seen: 0.011"
    joints_m = named_pose("fist", hand.rest_joints_m, handedness=Handedness.RIGHT, fist=hand.fist)
    skin_m = DetailedHand.of(hand, 1.0).posed_m(hand.skeleton().bones(joints_m))
    reached = [covered(one, joints_m, skin_m) > 0.8 * registration.REACH_ALPHA for one in (small, grown)]
    assert (~reached[1]).mean() < 0.2 * (~reached[0]).mean(), "seen: 0.07 % of 0.7 %"


def covered(avatar: HandAvatar, joints_m: np.ndarray, place_m: np.ndarray) -> np.ndarray:
    """(P,) how much the Gaussians that are nearest to places (P, 3) cover of them."""
    posed = Posing(avatar)(joints_m)
    apart_m, near = KDTree(posed.position_m).query(place_m, k=registration.REACH_NEIGHBORS)
    return (avatar.opacity[near] * np.exp(-0.5 * (apart_m / posed.sigma_m[near]) ** 2)).sum(1)
