"""The moments of a movement: when a shutter opens, and what stands between the moments that somebody gives."""

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.avatar.learned import CAPSULE_RADII_MM
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.rotations import axis_rotation
from jghand_engine.render.blur import (
    DISC_DISCREPANCY,
    EDGE_CURVATURE,
    FOCUS_ERROR_MAX,
    Moment,
    check_moments,
    disc_px,
    filled,
    focus_count,
    focus_error,
    middle,
    motion_count,
    pinholes,
    shutter_at,
    way_px,
)
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.render.shadow import vogel_disc
from jghand_engine.template.builtin import load_template

HAND_M = load_template().joints_m + np.array([0.0, 0.0, 0.6])
STEP_M = np.array([0.01, 0.002, 0.0])
CAMERA = Camera(200, 100, 150.0, 160.0, 100.0, 50.0, np.eye(4))


def test_a_shutter_is_open_for_half_of_its_time_before_a_frame_and_half_after_it():
    motion = np.stack([HAND_M + k * STEP_M for k in range(3)])
    for index, before, after in ((0, 0, 1), (1, 1, 1), (2, 1, 0)):  # nothing moves before the first and after the last
        first, here, last = (moment.joints_m[0] for moment in shutter_at(motion, index, 0.6, CAMERA))
        # the middles of its thirds
        np.testing.assert_allclose(first, motion[index] - 0.2 * before * STEP_M, atol=1e-12)
        np.testing.assert_allclose(here, motion[index])
        np.testing.assert_allclose(last, motion[index] + 0.2 * after * STEP_M, atol=1e-12)
    (alone,) = shutter_at(motion, 1, 0.0, CAMERA)
    np.testing.assert_allclose(alone.joints_m[0], motion[1])


def test_exposures_are_evenly_spread_over_the_time_that_the_shutter_is_open():
    opened = shutter_at(np.stack([HAND_M - STEP_M, HAND_M, HAND_M + STEP_M]), 1, 1.0, CAMERA)
    between, shares = filled(opened, [1.0, 2.0, 3.0], [0])
    places = [moment.joints_m[0] - HAND_M for moment in between]
    wanted = ((np.arange(len(between)) + 0.5) / len(between) - 0.5)[:, None, None] * STEP_M
    assert len(between) > 3
    np.testing.assert_allclose(places, np.repeat(wanted, JOINT_COUNT, axis=1), atol=1e-12)
    weights = 0.5 + 3 * (np.arange(len(between)) + 0.5) / len(between)
    np.testing.assert_allclose(shares, weights / weights.sum())


def test_moments_that_are_far_apart_get_others_between_them_in_even_steps():
    """Hands, cameras and lenses go on beyond the two that are given by half a step, and weights count in between."""
    turned = np.eye(4)
    turned[:3, :3] = axis_rotation(np.array([0.0, 1.0, 0.0]), np.array(0.1))
    turned[:3, 3] = [0.02, 0.0, 0.0]
    first = Moment([HAND_M], replace(CAMERA, lens=Lens(0.01, 0.5)))
    last = Moment([HAND_M + 5 * STEP_M], replace(CAMERA, fx=170.0, camera_from_world=turned, lens=Lens(0.03, 0.7)))
    between, shares = filled([first, last], [1.0, 3.0], [0])
    count = len(between)
    assert count > 4
    parts = (np.arange(count) + 0.5) / (count / 2) - 0.5
    for moment, part in zip(between, parts, strict=True):
        np.testing.assert_allclose(moment.joints_m[0], HAND_M + 5 * part * STEP_M, atol=1e-12)
        assert moment.camera.fx == pytest.approx(150 + 20 * part)
        assert moment.camera.lens is not None
        assert moment.camera.lens.aperture_m == pytest.approx(0.01 + 0.02 * part)
        assert moment.camera.lens.focus_m == pytest.approx(0.5 + 0.2 * part)
        angle = np.arctan2(moment.camera.camera_from_world[0, 2], moment.camera.camera_from_world[0, 0])
        assert angle == pytest.approx(0.1 * part)
        here = -moment.camera.camera_from_world[:3, :3].T @ moment.camera.camera_from_world[:3, 3]
        np.testing.assert_allclose(here, part * -turned[:3, :3].T @ turned[:3, 3], atol=1e-12)
    weights = 1 + 2 * parts
    np.testing.assert_allclose(shares, np.maximum(weights, 0) / np.maximum(weights, 0).sum(), atol=1e-12)


def test_moments_that_are_near_each_other_stay_as_they_are():
    moments = [Moment([HAND_M], CAMERA), Moment([HAND_M + 1e-3], CAMERA)]
    assert filled(moments, [1.0, 3.0], [0]) == (moments, [0.25, 0.75])
    # more than are needed
    many = [Moment([HAND_M + 2e-4 * k], CAMERA) for k in range(8)]
    assert 1 < motion_count(way_px(many, [0])) < 8
    assert filled(many, [1.0] * 8, [0]) == (many, [0.125] * 8)


def test_moments_of_a_hand_at_rest_are_one_image():
    moments = [Moment([HAND_M + 1e-6 * k], CAMERA) for k in range(8)]
    assert filled(moments, [1.0] * 8, [0]) == ([middle(moments)], [1.0])


def test_a_way_is_as_long_as_if_the_hand_went_all_the_time_as_fast_as_in_its_fastest_step():
    places = [0.0, 0.01, 0.04]
    moments = [Moment([HAND_M + np.array([x, 0.0, 0.0])], CAMERA) for x in places]
    nearest_m = min(CAMERA.project(HAND_M)[1])
    assert way_px(moments, [0]) == pytest.approx(3 * 0.03 * CAMERA.fx / nearest_m)
    assert way_px(moments, []) == way_px(moments[:1], [0]) == 0.0


@pytest.mark.parametrize(("focus_m", "end"), [(2.0, "near"), (0.3, "far")])
def test_the_largest_disc_is_that_of_the_flesh_farthest_out_of_focus(focus_m: float, end: str):
    view, depth_m = replace(CAMERA, lens=Lens(0.02, focus_m)), HAND_M[:, 2]
    for scale in (1.0, 1.5):
        flesh_m = 1e-3 * max(CAPSULE_RADII_MM) * scale
        end_m = depth_m.min() - flesh_m if end == "near" else depth_m.max() + flesh_m
        assert disc_px(view, [HAND_M], scale) == pytest.approx(160 * 0.02 * abs(1 / focus_m - 1 / end_m))
    assert disc_px(view, []) == disc_px(CAMERA, [HAND_M]) == 0


def test_a_lens_has_the_least_number_of_pinholes_within_the_bound():
    for size_px in (2.0, 3.0, 5.0):
        count = focus_count(size_px)
        assert focus_error(size_px, count) <= FOCUS_ERROR_MAX < focus_error(size_px, count - 1)
    # pinholes that stand for a square of a pixel each: the midpoint rule, which misses a 24th of the second derivative
    assert focus_error(0.5, 1) == pytest.approx(np.pi / 4 * 0.5**2 / 24 * EDGE_CURVATURE)
    # any disc, whatever its size: the discrepancy of the samples
    assert focus_count(float("inf")) == np.ceil((DISC_DISCREPANCY / FOCUS_ERROR_MAX) ** (4 / 3))


def test_a_little_blur_takes_few_pictures():
    """What a user waits for: of ways and discs of up to some pixels, and of any that is long or wide."""
    assert [motion_count(length_px) for length_px in (0.5, 1.0, 2.0, 5.0, 20.0, np.inf)] == [2, 3, 4, 6, 20, 128]
    assert [focus_count(size_px) for size_px in (0.5, 1.0, 2.0, 4.0, np.inf)] == [1, 2, 7, 26, 86]


def test_the_pinholes_of_all_moments_are_one_sunflower_on_the_lens():
    """Each place is taken once."""
    view = replace(CAMERA, lens=Lens(0.02, 0.5))
    eyes_m = np.array([one.eye_m[:2] for index in range(5) for one in pinholes(view, index, 4, 5)])
    wanted_m = 0.01 * vogel_disc(20)
    np.testing.assert_allclose(sorted(map(tuple, eyes_m)), sorted(map(tuple, wanted_m)), atol=1e-12)
    assert pinholes(CAMERA, 2, 3, 5) == [CAMERA] * 3


@pytest.mark.parametrize("weights", [[1.0], [1.0, 1.0, 1.0], [1.0, -1.0], [1.0, np.inf], [np.nan, 1.0], [0.0, 0.0]])
def test_weights_are_one_for_each_moment_and_of_some_weight(weights: list[float]):
    moments = [Moment([HAND_M], CAMERA)] * 2
    check_moments(moments, [0.0, 1.0])
    with pytest.raises(InputError, match="weights of moments: wanted 2"):
        check_moments(moments, weights)


def test_moments_of_an_image_are_of_one_size_and_not_none():
    other = replace(CAMERA, width=201)
    for moments in ([], [Moment([HAND_M], CAMERA), Moment([HAND_M], other)]):
        with pytest.raises(InputError, match="moments of an image"):
            check_moments(moments, [1.0] * len(moments))
