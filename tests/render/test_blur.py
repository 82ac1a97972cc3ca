"""The moments of a movement: when a shutter opens, and what stands between the moments that somebody gives."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.rotations import axis_rotation
from jghand_engine.render.blur import Moment, exposures, filled, shutter_at
from jghand_engine.render.camera import Camera, Lens
from jghand_engine.template.builtin import load_template

HAND_M = load_template().joints_m + np.array([0.0, 0.0, 0.6])
STEP_M = np.array([0.01, 0.002, 0.0])
CAMERA = Camera(200, 100, 150.0, 160.0, 100.0, 50.0, np.eye(4))


def test_a_shutter_is_open_for_half_of_its_time_before_a_frame_and_half_after_it():
    motion = np.stack([HAND_M + k * STEP_M for k in range(3)])
    for index, before, after in ((0, 0, 1), (1, 1, 1), (2, 1, 0)):  # nothing moves before the first and after the last
        shutter = shutter_at(motion, index, 0.4)
        assert shutter is not None
        np.testing.assert_allclose(shutter.opens_m[0], motion[index] - 0.2 * before * STEP_M, atol=1e-12)
        np.testing.assert_allclose(shutter.closes_m[0], motion[index] + 0.2 * after * STEP_M, atol=1e-12)
    assert shutter_at(motion, 1, 0.0) is None


def test_exposures_are_evenly_spread_over_the_time_that_the_shutter_is_open():
    shutter = shutter_at(np.stack([HAND_M - STEP_M, HAND_M, HAND_M + STEP_M]), 1, 1.0)
    places = [joints[0] - HAND_M for joints, _ in exposures([HAND_M], CAMERA, shutter, 4)]
    wanted = np.array([-0.375, -0.125, 0.125, 0.375])[:, None, None] * STEP_M
    np.testing.assert_allclose(places, np.repeat(wanted, JOINT_COUNT, axis=1), atol=1e-12)


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
    assert count % 2 == 0
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
    moments = [Moment([HAND_M], CAMERA), Moment([HAND_M + 1e-5], CAMERA)]
    assert filled(moments, [1.0, 3.0], [0]) == (moments, [0.25, 0.75])
