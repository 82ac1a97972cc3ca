"""Pictures of known light: what is mixed of their groups, and the light that goes with it."""

import numpy as np
import pytest

from jghand_engine.avatar.scene_light import Lamp, World
from jghand_engine.captures.known_light import KnownLight, LitPicture, MixedPicture, fit_exposure, mix, random_weights
from jghand_engine.native.scene_light_task import LampKind

LIGHT = KnownLight(
    World(np.ones((4, 8, 3), np.float32)),
    (Lamp(LampKind.SUN, (9.0, 8.0, 7.0), (1.0, 0.0, 0.0)),),
    (
        Lamp(LampKind.SUN, (3.0, 3.0, 3.0), (0.0, 1.0, 0.0)),
        Lamp(LampKind.POINT, (1.0, 2.0, 3.0), (0.0, 0.0, 1.0), radius_m=0.01),
    ),
)


@pytest.fixture
def picture() -> LitPicture:
    """Three groups in a box of 5 x 6 pixels, one in from the left and two from the top of 8 x 10."""
    groups = np.random.default_rng(0).random((3, 6, 5, 3)).astype(np.float16)
    return LitPicture(groups, np.full((6, 5), 255, np.uint8), (1, 2), (8, 10), LIGHT)


def mixed(picture: LitPicture, *seed: int) -> MixedPicture:
    return mix(picture, random_weights(picture.light, np.random.default_rng(seed)))


def test_a_mix_is_the_sum_of_the_weighted_groups_and_its_light_is_weighted_alike(picture):
    for seed in range(20):
        view = mixed(picture, seed)
        expected = (picture.groups.astype(np.float64) * view.weight[:, None, None]).sum(0)
        np.testing.assert_allclose(view.rgb[2:8, 1:6], expected, atol=1e-5)
        assert view.rgb.shape == (10, 8, 3)
        assert view.rgb.sum() == pytest.approx(expected.sum(), rel=1e-4)
        assert view.alpha.sum() == 30
        on = view.weight.any(1)
        light = view.light
        assert (light.world is not None) is bool(on[0])
        lamps = list(light.lamps)
        if light.world is not None:
            np.testing.assert_allclose(light.world.radiance[0, 0], view.weight[0])
            # the light of the world's suns is in its group
            np.testing.assert_allclose(lamps.pop().rgb, [9, 8, 7] * view.weight[0], rtol=1e-6)
        kept = [(lamp, weight) for lamp, weight in zip(LIGHT.lamps, view.weight[1:], strict=True) if weight.any()]
        for lamp, (before, weight) in zip(lamps, kept, strict=True):
            np.testing.assert_allclose(lamp.rgb, np.array(before.rgb) * weight, rtol=1e-6)
            assert lamp.place_m == before.place_m


def test_mixes_are_seeded_and_differ_from_step_to_step(picture):
    first, again, other = (mixed(picture, 0, step) for step in (1, 1, 2))
    np.testing.assert_array_equal(first.rgb, again.rgb)
    assert not np.array_equal(first.weight, other.weight)


def test_lights_are_on_as_often_as_they_should_and_never_all_off():
    weights = np.stack([random_weights(LIGHT, np.random.default_rng(seed)) for seed in range(3000)])
    on = weights.any(-1)
    assert on.any(1).all()
    # 0.75, 0.6 and 0.6, of those in which not all are off: 1 - 0.25 * 0.4 * 0.4
    np.testing.assert_allclose(on.mean(0), np.array([0.75, 0.6, 0.6]) / 0.96, atol=0.03)
    logarithms = np.log(weights[on])
    assert logarithms.mean(-1).std() == pytest.approx(np.hypot(0.6, 0.25 / 3**0.5), rel=0.05)
    assert (logarithms - logarithms.mean(-1, keepdims=True)).std() == pytest.approx(0.25 * (2 / 3) ** 0.5, rel=0.05)


def test_the_exposure_brings_the_bright_part_of_the_hand_to_seven_tenths_within_bounds():
    alpha = np.ones((10, 10))
    alpha[0] = 0.5
    ramp = np.linspace(0, 2, 100).reshape(10, 10)
    rgb = np.repeat(ramp[..., None], 3, 2)
    assert fit_exposure(rgb, alpha) * np.quantile(ramp[1:], 0.95) == pytest.approx(0.7)
    assert fit_exposure(1e-6 * rgb, alpha) == 12
    assert fit_exposure(1e6 * rgb, alpha) == 0.2
    assert fit_exposure(rgb, np.zeros((10, 10))) == 1


def test_a_light_without_a_world_mixes_too(picture):
    lamps = KnownLight(None, (), LIGHT.lamps)
    one = LitPicture(picture.groups[1:], picture.alpha, picture.corner_px, picture.size_px, lamps)
    view = mix(one, np.array([[2.0, 2.0, 2.0], [0.0, 0.0, 0.0]]))
    np.testing.assert_allclose(view.rgb[2:8, 1:6], 2 * picture.groups[1].astype(np.float32))
    assert [lamp.rgb for lamp in view.light.lamps] == [(6.0, 6.0, 6.0)]
    assert not lamps.weighted(np.zeros((2, 3))).lamps
