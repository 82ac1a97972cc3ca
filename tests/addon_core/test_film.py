"""The engine's picture as Blender's passes."""

from __future__ import annotations

import numpy as np
import pytest

from blender_addon.core import film


def picture(seed: int = 0) -> np.ndarray:
    """(40, 30, 4) premultiplied, display-referred: a soft patch somewhere, nothing elsewhere."""
    rng = np.random.default_rng(seed)
    rgba = np.zeros((40, 30, 4), np.float32)
    alpha = rng.random((12, 9, 1), np.float32)
    alpha[0, 0], alpha[3, 4] = 0, 1
    rgba[20:32, 5:14, :3], rgba[20:32, 5:14, 3:] = rng.random((12, 9, 3), np.float32) * alpha, alpha
    return rgba


def encoded(linear: np.ndarray) -> np.ndarray:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0) ** (1 / 2.4) - 0.055)


def test_straight_colors_are_decoded_and_alpha_stays():
    rgba = picture()
    linear = film.scene_linear(rgba)
    assert linear.dtype == np.float32
    np.testing.assert_array_equal(linear[..., 3], rgba[..., 3])
    seen = rgba[..., 3] > 0
    straight, decoded = (values[seen][:, :3] / values[seen][:, 3:] for values in (rgba, linear))
    # worst observed 6e-7
    np.testing.assert_allclose(encoded(decoded), straight, atol=2e-6)
    assert not linear[~seen].any()


def test_a_dark_and_a_middle_gray_are_what_the_standard_says():
    rgba = np.array([[[0.04045, 0.02, 0.0, 1.0], [0.5, 0.8, 1.0, 1.0]]], np.float32)
    wanted = [[0.0031308, 0.00154799, 0.0], [0.2140411, 0.6038273, 1.0]]
    np.testing.assert_allclose(film.scene_linear(rgba)[0, :, :3], wanted, rtol=1e-5)


@pytest.mark.parametrize("covered", [0.0, 1.0])
def test_a_picture_that_is_empty_or_full_is_decoded_too(covered):
    rgba = np.full((5, 7, 4), covered, np.float32)
    np.testing.assert_array_equal(film.scene_linear(rgba), rgba)


def test_a_background_is_seen_through_what_is_half_transparent():
    linear = film.scene_linear(picture())
    color = np.array([0.1, 0.5, 2.0], np.float32)
    came = film.over(linear, color.tolist())
    np.testing.assert_allclose(came[..., :3], linear[..., :3] + (1 - linear[..., 3:]) * color, atol=1e-6)
    assert (came[..., 3] == 1).all()


def test_depth_is_in_units_and_nothing_is_far_away():
    depth = film.depth_units(np.array([[0.0, 0.25, 2.0]], np.float32), 0.01)
    np.testing.assert_allclose(depth, [[1e10, 25.0, 200.0]])
    assert depth.dtype == np.float32


def test_rows_are_given_from_the_bottom():
    values = np.arange(12, dtype=np.uint8).reshape(3, 2, 2)
    np.testing.assert_array_equal(film.from_bottom(values), [8, 9, 10, 11, 4, 5, 6, 7, 0, 1, 2, 3])
    assert film.from_bottom(values).dtype == np.float32
