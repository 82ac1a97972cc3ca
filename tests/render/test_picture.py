"""What the rasterizer hands on, and how good a picture is."""

import math

import numpy as np
import pytest
import torch

from jghand_engine.color import PSNR_MAX_DB, decibels
from jghand_engine.learn.reference import Picture
from jghand_engine.learn.shadow import normalized_depth
from jghand_engine.native import contract
from jghand_engine.render.image import Box, Image


def picture_with(alpha: list[float], depth_m: list[float]) -> Picture:
    alphas, depths = (torch.tensor([values], dtype=torch.float64) for values in (alpha, depth_m))
    planes = torch.cat([torch.rand(3, 1, len(alpha), dtype=torch.float64), alphas[None], (alphas * depths)[None]])
    return Picture.from_planes(planes, visible_gaussians=3, invalid_gaussians=2)


def test_planes_become_color_coverage_and_depth():
    planes = torch.rand(5, 4, 6, generator=torch.Generator().manual_seed(0))
    picture = Picture.from_planes(planes, visible_gaussians=3, invalid_gaussians=2)
    assert picture.rgb.shape == (4, 6, 3)
    for channel in range(3):
        assert torch.equal(picture.rgb[..., channel], planes[channel])
    assert torch.equal(picture.alpha, planes[3])
    assert torch.equal(picture.depth_sum, planes[4])
    assert (picture.visible_gaussians, picture.invalid_gaussians) == (3, 2)


def test_depth_is_the_mean_of_what_covers_a_pixel_where_enough_does():
    least = contract.DEPTH_ALPHA_MIN
    picture = picture_with([0.0, least / 2, least, math.nextafter(least, 1), 1.0], [0.7] * 5)
    assert picture.valid.tolist() == [[False, False, False, True, True]]
    assert picture.depth_m[0].tolist() == pytest.approx([0, 0, 0, 0.7, 0.7], abs=1e-15)
    depth_m, valid = normalized_depth(picture.depth_sum, picture.alpha)
    assert torch.equal(valid, picture.valid)
    assert torch.equal(depth_m, picture.depth_m)


def test_pixels_of_a_smaller_picture_are_means_and_their_depth_that_of_what_covers_them():
    rng = np.random.default_rng(0)
    rgba, weights = rng.random((12, 6, 4), np.float32), rng.random((12, 6, 2), np.float32)
    depth_m = rng.uniform(0.3, 0.7, (12, 6)).astype(np.float32)
    # in the upper half pixels that nothing covers, or that have no depth, but for one
    rgba[:6, :3], depth_m[:6, 3:] = 0, 0
    depth_m[4, 5], rgba[4, 5, 3] = 0.5, 1
    small = Image(Box(3, 5, 2, 4), rgba, depth_m, weights).averaged_down(3)
    assert small.box == (3, 5, 2, 4)
    assert small.depth_m is not None
    for y, x in np.ndindex(4, 2):
        block = np.s_[3 * y : 3 * y + 3, 3 * x : 3 * x + 3]
        np.testing.assert_allclose(small.rgba[y, x], rgba[block].mean((0, 1)), rtol=1e-6)
        np.testing.assert_allclose(small.weights[y, x], weights[block].mean((0, 1)), rtol=1e-6)
        covered = rgba[block][..., 3] * (depth_m[block] > 0)
        wanted_m = float((covered * depth_m[block]).sum() / covered.sum()) if covered.any() else 0.0
        assert small.depth_m[y, x] == pytest.approx(wanted_m, rel=1e-6)


def test_decibels_count_tenfold_errors_and_end_at_a_cap():
    assert [decibels(10.0**-n) for n in range(4)] == pytest.approx([0, 10, 20, 30])
    assert decibels(4.0) == pytest.approx(-6.0206, abs=1e-4)
    cap = PSNR_MAX_DB
    assert decibels(0.0) == decibels(10 ** (-cap / 10) / 2) == cap
    assert decibels(2 * 10 ** (-cap / 10)) == pytest.approx(cap - 10 * math.log10(2))
