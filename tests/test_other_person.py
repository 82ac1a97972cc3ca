"""A trained hand as another person's."""

from dataclasses import replace

import numpy as np
import pytest
from detail_samples import detail_of, flat
from other_person import RELIEF_GAIN, Somebody, as_person, person_detail, somebody

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
    assert np.array_equal(before.normal, after.normal)
    for name in ("roughness", "softness"):
        assert np.array_equal(getattr(before.response, name), getattr(after.response, name)), name
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
    assert (after.softness < before.softness).all()
    np.testing.assert_allclose(np.median(after.roughness - before.roughness), 0.05, atol=1e-3)


def test_a_child_has_its_own_joints_at_rest_and_shorter_bones(avatar, other, tmp_path):
    assert np.array_equal(other.canonical_joints_m, avatar.canonical_joints_m)
    assert hand_length(other.rest_joints_m) < 0.8 * hand_length(avatar.rest_joints_m)
    save_avatar(tmp_path / "child.jghand", other)
    np.testing.assert_array_equal(load_avatar(tmp_path / "child.jghand").own_joints_m, other.own_joints_m)


def test_the_left_hand_is_the_mirror_image_of_the_right(other):
    right = Posing(other, threads=1)(other.rest_joints_m)
    left = Posing(other.for_hand(Handedness.LEFT), threads=1)(other.rest_joints_m * [-1, 1, 1])
    np.testing.assert_allclose(left.position_m * [-1, 1, 1], right.position_m, atol=2e-6)


def test_detail_has_the_persons_fine_colors_and_no_wide_ones(child):
    stripes = 1 + 0.2 * np.sin(2 * np.pi * np.arange(TEXELS) / 4)[:, None, None]
    bright = np.linspace(0.2, 0.6, TEXELS)[None, :, None]
    maps = replace(child.maps, rgb=np.broadcast_to(stripes * bright, (TEXELS, TEXELS, 3)).astype(np.float32))
    came = log_ratios(person_detail(detail_of(flat(TEXELS, 0.5)), replace(child, maps=maps)).texture)[..., 1]
    skin = child.covered[..., 0] > 0
    assert not came[~skin].any()
    np.testing.assert_allclose(came[skin], np.broadcast_to(np.log(stripes[..., 0]), came.shape)[skin], atol=0.06)


def test_wrinkles_of_straight_joints_go_and_folds_deepen_where_joints_bend(child):
    flat_maps = {name: np.zeros((TEXELS, TEXELS), np.float32) for name in FINE_LAYERS}
    for layer, straight, bent in (("static", 1, 1), ("straight", 1, 0), ("fold", 1, 1.5)):
        fine = {**flat_maps, layer: np.full((TEXELS, TEXELS), 0.1, np.float32)}
        one = replace(child, maps=replace(child.maps, fine=fine))
        height = person_detail(detail_of(flat(TEXELS, 0.0)), one).relief.height[child.covered[..., 0] > 0]
        wanted_m = 1e-4 * RELIEF_GAIN * np.array([straight, bent])
        np.testing.assert_allclose(height * HEIGHT_STEP_M, np.broadcast_to(wanted_m, height.shape), atol=HEIGHT_STEP_M)


def test_a_hand_without_known_light_is_no_albedo_and_is_refused(own, child):
    with pytest.raises(InputError, match="known light"):
        as_person(load_painted(handedness=Handedness.RIGHT).prefix(100), own, child)
