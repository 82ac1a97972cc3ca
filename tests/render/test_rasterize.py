"""Conformance: the native kernel draws the picture of the float64 reference (RENDERING 3, promises 3 and 12 to 16)."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from splat_scenes import (
    DRAWING,
    assert_same_bits,
    assert_same_picture,
    camera_for,
    draw,
    exact,
    front_camera,
    gaussians_from,
    hand_gaussians,
    in_precision,
    joined,
    oblong_camera,
    planes_of,
    reordered,
    stretched,
)

from jghand_engine.errors import InputError
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import camera_frame
from jghand_engine.native import contract

native = pytest.mark.parametrize("backend", DRAWING)
every_backend = pytest.mark.parametrize("backend", ["torch", *DRAWING])


# ---- the low pass of the pictures that Gaussians were learned from ---------------------------------------------------


@native
@pytest.mark.parametrize("shape", [lambda spheres: spheres, stretched], ids=["spheres", "ellipsoids"])
def test_pictures_finer_than_those_learned_from_agree_with_the_reference(shape, backend):
    gaussians = replace(shape(hand_gaussians(1500)), pixel_m=1e-3)
    for camera in (camera_for(120, 80, distance_m=0.1), camera_for(120, 80, distance_m=2.0)):
        assert_same_picture(draw(gaussians, camera, backend), exact(gaussians, camera), depth_scale_m=2.0)
    coarser = camera_for(60, 40, distance_m=2.0)
    assert_same_bits(draw(gaussians, coarser, backend), draw(replace(gaussians, pixel_m=0.0), coarser, backend))


@every_backend
def test_a_sheet_is_as_closed_in_finer_pictures_as_in_its_own(backend):
    """A Gaussian every millimeter, which pixels of half a millimeter blur together, seen five times as fine."""
    place_m = 1e-3 * np.stack(np.meshgrid(np.arange(-8.0, 9), np.arange(-8.0, 9), [100.0]), -1).reshape(-1, 3)
    sheet = gaussians_from(place_m, np.full(289, 0.35e-3), np.full(289, 1.0), np.ones((289, 3)))
    own = draw(sheet, front_camera(12, 12, focal_px=200.0), backend).alpha
    finer = front_camera(60, 60, focal_px=1000.0)
    closed, open_ = (draw(replace(sheet, pixel_m=size_m), finer, backend).alpha[2::5, 2::5] for size_m in (0.5e-3, 0.0))
    assert float((closed - own).abs().max()) < 1e-3
    assert float((own - open_).min()) > 0.02


# ---- promise 3: the picture -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def hand_60k():
    """A hand of the size that is drawn, with the reference's picture of it."""
    gaussians, camera = hand_gaussians(60_000), camera_for(512, 334)
    return gaussians, camera, exact(gaussians, camera)


@native
def test_hand_of_60000_gaussians_agrees_with_the_reference(hand_60k, backend):
    gaussians, camera, want = hand_60k
    got = draw(gaussians, camera, backend)
    assert_same_picture(got, want, depth_scale_m=0.7)
    assert (got.visible_gaussians, got.invalid_gaussians) == (want.visible_gaussians, 0)


SIZES = [(1, 1), (2, 3), (4, 4), (5, 17), (16, 16), (17, 15), (33, 64), (160, 1), (1, 160), (250, 130)]


@native
@pytest.mark.parametrize(("width", "height"), SIZES)
def test_every_picture_size_agrees_with_the_reference(width, height, backend):
    gaussians, camera = hand_gaussians(1500, sigma_mm=(1, 3), opacity=(0.01, 1.0)), camera_for(width, height)
    assert_same_picture(draw(gaussians, camera, backend), exact(gaussians, camera), depth_scale_m=0.7)


@native
@pytest.mark.parametrize("count", [0, 1, 2, 15, 16, 17, 129, 1000, 120_000])
def test_every_number_of_gaussians_agrees_with_the_reference(count, backend):
    gaussians, camera = hand_gaussians(count, opacity=(0.02, 0.9)), camera_for(96, 64)
    got, want = draw(gaussians, camera, backend), exact(gaussians, camera)
    assert_same_picture(got, want, depth_scale_m=0.7)
    assert got.visible_gaussians == want.visible_gaussians


@native
@pytest.mark.parametrize("alpha_min", [1 / 64, 1 / 255, 1 / 1024, 1 / 16384, 1e-6, contract.NATIVE_ALPHA_MIN])
def test_every_cut_off_agrees_with_the_reference(alpha_min, backend):
    gaussians, camera = hand_gaussians(1500, sigma_mm=(1, 3), opacity=(0.001, 1.0)), camera_for(100, 70)
    got = draw(gaussians, camera, backend, alpha_min=alpha_min, t_stop=0.0)
    want = exact(gaussians, camera, alpha_min=alpha_min)
    error = (planes_of(got).double() - planes_of(want)).abs()[:4].amax(0)
    # at most a few contributions as large as the cut itself fall on its other side; the rest is rounding
    assert float(error.max()) <= 2 * alpha_min + 5e-6  # observed: 1.0 alpha_min, and 2.2e-6 below a cut of 1e-6
    assert int((error > 5e-6).sum()) <= 2


@native
@pytest.mark.parametrize("distance_m", [0.02, 0.05, 0.12, 3.0])
def test_camera_inside_and_near_the_hand_agrees_with_the_reference(distance_m, backend):
    gaussians = hand_gaussians(3000, sigma_mm=(1, 2))
    camera = camera_for(120, 80, distance_m=distance_m)
    assert_same_picture(draw(gaussians, camera, backend), exact(gaussians, camera), depth_scale_m=distance_m + 0.1)


@native
def test_wide_angle_shifted_principal_point_and_oblong_pixels_agree_with_the_reference(backend):
    gaussians = hand_gaussians(2000, sigma_mm=(2, 5))
    camera = oblong_camera(120, 80)
    assert_same_picture(draw(gaussians, camera, backend), exact(gaussians, camera), depth_scale_m=0.3)


@native
def test_stopping_early_costs_at_most_the_threshold(backend):
    gaussians, camera = hand_gaussians(4000, sigma_mm=(2, 4), opacity=(0.5, 0.99)), camera_for(120, 80)
    whole = planes_of(draw(gaussians, camera, backend, t_stop=0.0))
    for t_stop in (1e-4, 1e-2):
        stopped = planes_of(draw(gaussians, camera, backend, t_stop=t_stop))
        assert float((whole - stopped)[:4].abs().max()) <= t_stop + 1e-6


# ---- promises 12 to 16 ----------------------------------------------------------------------------------------------


@native
@pytest.mark.parametrize("log_sigma", [-30, -20, -10, -7, -5, -3, -1, 0, 1, 2])
def test_extreme_radii_stay_visible(log_sigma, backend):
    gaussians = gaussians_from([[0.01, -0.02, 0.7]], [math.exp(log_sigma)], [0.8], [[0.2, 0.4, 0.6]])
    camera = front_camera(48, 32, 300.0)
    got, want = draw(gaussians, camera, backend), exact(gaussians, camera)
    assert got.visible_gaussians == 1
    assert float(got.alpha.max()) > 0.1
    assert_same_picture(got, want)


@native
def test_120000_gaussians_over_the_whole_picture_are_finite_and_opaque(backend):
    gaussians = hand_gaussians(120_000, sigma_mm=(300, 900), opacity=(0.01, 0.05))
    picture = draw(gaussians, camera_for(64, 48), backend)
    assert picture.visible_gaussians == 120_000
    assert bool(torch.isfinite(planes_of(picture)).all())
    assert float(picture.alpha.min()) > 0.999


def hidden_gaussians() -> Gaussians:
    """Behind the camera, beside the picture, too transparent, not a number."""
    behind = [[0.0, 0.0, -1.0]] * 300
    beside = [[5.0, 0.0, 1.0]] * 300
    faint = [[0.0, 0.0, 0.6]] * 300
    broken = [[math.nan, 0.0, 0.6]] * 100
    opacity = [0.9] * 600 + [0.003] * 300 + [0.9] * 100
    position = behind + beside + faint + broken
    return gaussians_from(position, [2e-3] * 1000, opacity, [[1.0, 1.0, 1.0]] * 1000)


@every_backend
def test_hidden_gaussians_change_no_bit_wherever_they_stand(backend):
    """Promise 13."""
    camera = front_camera(96, 64, 300.0)
    hand = hand_gaussians(2000, sigma_mm=(1, 3))
    hand.position_m[:, 2] += 0.6
    alone = draw(hand, camera, backend)
    for parts in ((hidden_gaussians(), hand), (hand, hidden_gaussians())):
        together = draw(joined(*parts), camera, backend)
        assert_same_bits(together, alone)
        assert (together.visible_gaussians, together.invalid_gaussians) == (2000, 100)


@native
def test_permuted_gaussians_give_the_same_bits_when_equal_depths_keep_their_order(backend):
    camera, count = camera_for(128, 96), 60_000
    hand = hand_gaussians(count)
    depth = camera_frame(hand.position_m, camera)[:, 2].numpy()
    assert len(np.unique(depth)) < count - 1000  # ties are common
    order = np.random.default_rng(3).permutation(count)
    shuffled_places = np.argsort(depth[order], kind="stable")  # of each group of equal depths
    order[shuffled_places] = order[np.lexsort((order, depth[order]))]  # the group's members, by their old index
    assert_same_bits(draw(reordered(hand, torch.from_numpy(order)), camera, backend), draw(hand, camera, backend))


@native
@pytest.mark.parametrize("shape", [lambda spheres: spheres, stretched], ids=["spheres", "ellipsoids"])
@pytest.mark.parametrize(("count", "size"), [(20_000, (512, 334)), (37, (19, 5)), (1, (1, 1))])
def test_the_same_bits_from_every_number_of_threads_and_on_every_run(count, size, shape, backend):
    """Promise 16, forward."""
    gaussians, camera = shape(hand_gaussians(count, sigma_mm=(1, 2))), camera_for(*size)
    once = draw(gaussians, camera, backend, threads=1)
    for threads in (1, 2, 3, 3):
        assert_same_bits(draw(gaussians, camera, backend, threads=threads), once)


@native
def test_depths_over_all_orders_of_magnitude_are_sorted(backend):
    """From a centimeter to 100 km: a hand needs fewer passes of the sort, this needs all of them."""
    random = torch.Generator().manual_seed(4)
    count = 3000
    depth = 0.011 * 10 ** (torch.rand(count, generator=random, dtype=torch.float64) * 7)
    position = torch.stack([torch.zeros_like(depth), torch.zeros_like(depth), depth], 1)
    rgb = torch.rand(count, 3, generator=random)
    gaussians = gaussians_from(position, depth * 0.1, torch.full((count,), 0.004), rgb)
    camera = front_camera(8, 8, 20.0)
    got, want = draw(gaussians, camera, backend, t_stop=0.0), exact(gaussians, camera)
    assert float((got.rgb.double() - want.rgb).abs().max()) <= 1e-4
    assert got.visible_gaussians == count


@native
def test_a_growing_hand_asks_for_longer_lists(backend):
    """The lists are sized by the last picture; a bigger one is drawn again with more room."""
    camera = camera_for(256, 160)
    for sigma_mm in (0.5, 20.0, 80.0, 0.5):
        gaussians = hand_gaussians(800, sigma_mm=(sigma_mm, sigma_mm), opacity=(0.1, 0.3))
        assert_same_picture(draw(gaussians, camera, backend), exact(gaussians, camera), depth_scale_m=0.7, flips=1)


# ---- errors ---------------------------------------------------------------------------------------------------------


def test_float64_gaussians_are_drawn_by_the_reference():
    gaussians, camera = in_precision(hand_gaussians(50), torch.float64), camera_for(16, 16)
    assert_same_bits(draw(gaussians, camera, "auto"), exact(gaussians, camera))


@native
def test_a_cut_below_the_kernels_range_is_refused(backend):
    with pytest.raises(InputError, match="alpha_min"):
        draw(hand_gaussians(10), camera_for(8, 8), backend, alpha_min=1e-12)
