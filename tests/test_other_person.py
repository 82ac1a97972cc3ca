"""A trained hand as another person's."""

from dataclasses import replace

import numpy as np
import pytest
from detail_samples import detail_of, flat
from other_person import DETAIL_MM, RELIEF_GAIN, Somebody, as_person, other_shape, person_detail, shown_albedo, somebody

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin, load_painted
from jghand_engine.avatar.detail import log_ratios
from jghand_engine.avatar.file import load_avatar, save_avatar
from jghand_engine.avatar.posing import Posing
from jghand_engine.avatar.relief import HEIGHT_STEP_M
from jghand_engine.avatar.relighting import thrown_back
from jghand_engine.captures.skin.maps import FINE_LAYERS, SkinMaps
from jghand_engine.captures.skin.person import Person
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import hand_length
from jghand_engine.template.texture import sample_bilinear

TEXELS = 256


def painted(seed: int, level: float) -> SkinMaps:
    """Skin of chance: nothing is drawn, so that it takes no time."""
    random = np.random.default_rng(seed)

    def layer(spread: float) -> np.ndarray:
        return (spread * random.standard_normal((TEXELS, TEXELS))).astype(np.float32)

    rgb = level * np.exp(layer(0.2))[..., None] * np.array([1.0, 0.7, 0.5], np.float32)
    coarse = {
        name: np.full((TEXELS, TEXELS), 0.1 * seed, np.float32) for name in ("static", "straight", "bent", "fold")
    }
    fine = {name: layer(0.02) for name in FINE_LAYERS}
    roughness = np.full((TEXELS, TEXELS), 0.4 + 0.05 * seed, np.float32)
    return SkinMaps(rgb.clip(0.01, 0.9), roughness, np.zeros_like(roughness), coarse, fine)


@pytest.fixture(scope="module")
def own() -> Somebody:
    return somebody(load_builtin(handedness=Handedness.RIGHT), "adult_woman", Person(), painted(0, 0.5))


@pytest.fixture(scope="module")
def avatar(own) -> HandAvatar:
    """A few Gaussians of the built-in hand that learned the colors of the maps."""
    hand = load_builtin(handedness=Handedness.RIGHT).prefix(200)
    colors = sample_bilinear(own.blurred(own.maps.rgb), hand.uvd[:, :2].astype(float))
    return replace(hand, rgb=colors.astype(np.float32))


@pytest.fixture(scope="module")
def child(avatar) -> Somebody:
    return somebody(avatar, "child", Person(melanin=0.9, age=0.0), painted(1, 0.15))


@pytest.fixture(scope="module")
def other(avatar, own, child) -> HandAvatar:
    return as_person(avatar, own, child)


def test_a_person_as_itself_stays_as_it_was(avatar, own):
    same = as_person(avatar, own, own)
    for name in ("position_m", "sigma_m", "rgb"):
        assert np.array_equal(getattr(same, name), getattr(avatar, name)), name
    before, after = avatar.learned, same.learned
    assert np.array_equal(before.response.softness, after.response.softness)
    assert np.array_equal(after.response.bounce, thrown_back(avatar, avatar.rgb))


def test_palm_and_back_have_the_colors_of_the_other_persons_maps(avatar, child, other):
    uv = avatar.uvd[:, :2].astype(float)
    for side in (1, -1):
        seen = side * avatar.learned.normal[:, 2] > 0.5
        wanted = sample_bilinear(child.maps.rgb, uv)[seen].mean(0)
        np.testing.assert_allclose(other.rgb[seen].mean(0), wanted, rtol=0.05)


def test_dark_skin_throws_less_light_back_and_lets_it_less_deep(avatar, other):
    before, after = avatar.learned.response, other.learned.response
    assert (after.bounce < 0.6 * thrown_back(avatar, avatar.rgb)).all()
    np.testing.assert_allclose(after.bounce, thrown_back(other, other.rgb), rtol=1e-5)
    assert (after.softness < before.softness).all()
    np.testing.assert_allclose(np.median(after.roughness - before.roughness), 0.05, atol=1e-3)


def test_a_child_has_its_own_joints_at_rest_and_shorter_bones(avatar, other, tmp_path):
    assert np.array_equal(other.canonical_joints_m, avatar.canonical_joints_m)
    assert hand_length(other.rest_joints_m) < 0.8 * hand_length(avatar.rest_joints_m)
    save_avatar(tmp_path / "child.jghand", other)
    np.testing.assert_array_equal(load_avatar(tmp_path / "child.jghand").own_joints_m, other.own_joints_m)


def test_skin_faces_where_the_others_shape_turns_it_and_throws_its_shadows_from_there(avatar, own, child, other):
    shaped = other_shape(avatar, own, child).learned
    turn_deg, off_deg = (
        np.degrees(np.arccos((shaped.normal * one.normal).sum(1).clip(-1, 1)))
        for one in (avatar.learned, other.learned)
    )
    # observed 1.2 degrees, and 0.02: Gaussians so near to one another that their normals become alike are few
    assert np.median(turn_deg) > 1
    assert np.median(off_deg) < 0.1
    np.testing.assert_allclose(other.learned.cast.anchors.position_m, shaped.cast.anchors.position_m)


def test_the_left_hand_is_the_mirror_image_of_the_right(other):
    right = Posing(other, threads=1)(other.rest_joints_m)
    left = Posing(other.for_hand(Handedness.LEFT), threads=1)(other.rest_joints_m * [-1, 1, 1])
    np.testing.assert_allclose(left.position_m * [-1, 1, 1], right.position_m, atol=2e-6)


def test_gloss_of_neighbors_becomes_alike_and_that_of_the_next_finger_is_not_asked(avatar, own):
    """Three Gaussians half a millimeter apart, the last of which looks the other way."""
    position_m, normal = avatar.position_m.copy(), avatar.learned.normal.copy()
    position_m[:3] = 1 + np.array([[0, 0, 0], [5e-4, 0, 0], [0, 5e-4, 0]])
    normal[:3] = [[0, 0, 1], [0, 0.28, 0.96], [0, 0, -1]]
    roughness, reflectance = (np.full(len(normal), value, np.float32) for value in (0.5, 0.02))
    roughness[:3], reflectance[:3] = [0.4, 0.5, 0.7], [0.02, 0.03, 0.05]
    response = replace(avatar.learned.response, roughness=roughness, reflectance=reflectance)
    learned = replace(avatar.learned, normal=normal, response=response)
    came = as_person(replace(avatar, position_m=position_m, learned=learned), own, own).learned
    assert came.normal[0] @ came.normal[1] > 0.999
    np.testing.assert_allclose(came.response.roughness[:3], [0.45, 0.45, 0.7], atol=0.01)
    np.testing.assert_allclose(came.response.reflectance[:3], [0.025, 0.025, 0.05], atol=1e-3)
    np.testing.assert_allclose(came.normal[2], normal[2], atol=1e-6)


def with_detail(avatar: HandAvatar, texture: np.ndarray) -> HandAvatar:
    """Its Gaussians are all of one color, and show none."""
    return replace(avatar, rgb=np.full_like(avatar.rgb, 0.5), detail=detail_of(texture))


def test_gaussians_show_the_outermost_of_them_first(own):
    detail = detail_of(flat(TEXELS, 0.0))
    face = 4000
    place_m, outwards = detail.position_m[detail.faces[face]].mean(0), detail.normals[detail.faces[face, 0]]
    # 1 and 2 mm below the skin, so wide that a texel may lie a millimeter beside
    hand = load_painted(handedness=Handedness.RIGHT).prefix(50)
    position_m, sigma_m, opacity, rgb = (
        each.copy() for each in (hand.position_m + 1, hand.sigma_m, hand.opacity, hand.rgb)
    )
    position_m[:2], sigma_m[:2] = place_m - np.array([[0.002], [0.001]]) * outwards, 0.05
    opacity[:2], rgb[:2] = [0.9, 0.6], np.eye(3)[:2]
    two = replace(hand, position_m=position_m, sigma_m=sigma_m, opacity=opacity, rgb=rgb)
    middle = np.floor(TEXELS * detail.face_uv[face].mean(0)).astype(int)
    came = shown_albedo(two, detail, own)[TEXELS - 1 - middle[1], middle[0]]
    np.testing.assert_allclose(came, np.array([0.4 * 0.9, 0.6, 0]) / (0.4 * 0.9 + 0.6), atol=2e-3)


def test_what_gaussians_show_is_not_in_the_detail_again(avatar, child):
    """Maps of one color: what is left is what Gaussians have too much, reversed."""
    rng = np.random.default_rng(5)
    uneven = replace(with_detail(avatar, flat(TEXELS, 0.0)), rgb=rng.uniform(0.3, 0.9, avatar.rgb.shape).astype("f4"))
    one = replace(child, maps=replace(child.maps, rgb=np.full((TEXELS, TEXELS, 3), 0.5, np.float32)))
    shown = shown_albedo(uneven, uneven.detail, one)
    wanted = -np.log(shown / one.blurred(shown, DETAIL_MM))
    came = log_ratios(person_detail(uneven, one).texture)
    skin = child.covered[..., 0] > 0
    assert wanted[skin].std() > 0.03
    np.testing.assert_allclose(came[skin], wanted[skin], atol=0.08)


def test_detail_has_the_persons_fine_colors_and_no_wide_ones(avatar, child):
    stripes = 1 + 0.2 * np.sin(2 * np.pi * np.arange(TEXELS) / 4)[:, None, None]
    bright = np.linspace(0.2, 0.6, TEXELS)[None, :, None]
    maps = replace(child.maps, rgb=np.broadcast_to(stripes * bright, (TEXELS, TEXELS, 3)).astype(np.float32))
    came = log_ratios(person_detail(with_detail(avatar, flat(TEXELS, 0.5)), replace(child, maps=maps)).texture)[..., 1]
    skin = child.covered[..., 0] > 0
    assert not came[~skin].any()
    np.testing.assert_allclose(came[skin], np.broadcast_to(np.log(stripes[..., 0]), came.shape)[skin], atol=0.06)


def test_wrinkles_of_straight_joints_go_and_folds_deepen_where_joints_bend(avatar, child):
    flat_maps = {name: np.zeros((TEXELS, TEXELS), np.float32) for name in FINE_LAYERS}
    for layer, straight, bent in (("static", 1, 1), ("straight", 1, 0), ("fold", 1, 1.5)):
        fine = {**flat_maps, layer: np.full((TEXELS, TEXELS), 0.1, np.float32)}
        one = replace(child, maps=replace(child.maps, fine=fine))
        relief = person_detail(with_detail(avatar, flat(TEXELS, 0.0)), one).relief
        height = relief.height[child.covered[..., 0] > 0]
        wanted_m = 1e-4 * RELIEF_GAIN * np.array([straight, bent])
        np.testing.assert_allclose(height * HEIGHT_STEP_M, np.broadcast_to(wanted_m, height.shape), atol=HEIGHT_STEP_M)


def test_a_hand_without_known_light_is_no_albedo_and_is_refused(own, child):
    with pytest.raises(InputError, match="known light"):
        as_person(load_painted(handedness=Handedness.RIGHT).prefix(100), own, child)
