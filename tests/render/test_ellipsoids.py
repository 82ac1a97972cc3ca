"""Gaussians with covariances: the picture and the gradients of the float64 reference, and of spheres where they are."""

import math
from dataclasses import replace

import pytest
import torch
from splat_scenes import (
    DRAWING,
    ELLIPSOID_NAMES,
    NATIVE,
    GradientBounds,
    as_ellipsoids,
    assert_same_bits,
    assert_same_gradients,
    assert_same_picture,
    camera_for,
    draw,
    exact,
    front_camera,
    gaussians_from,
    gradients_of,
    hand_gaussians,
    in_precision,
    planes_of,
    stretched,
)
from test_rasterize_gradients import SCENES as SPHERES

from jghand_engine.errors import InputError
from jghand_engine.learn.gaussians import Gaussians, posed_covariance
from jghand_engine.learn.reference import rasterize_reference

every_backend = pytest.mark.parametrize("backend", ["torch", *DRAWING])
with_gradients = pytest.mark.parametrize("backend", ["torch", *NATIVE])


def stretched_hand(count: int, *, aspect: float = 4.0, **options) -> Gaussians:
    return stretched(hand_gaussians(count, **options), aspect=aspect)


SCENES = {
    name: lambda of=of: (stretched(of()[0]), of()[1]) for name, of in SPHERES.items() if name != "coarse pictures"
}
SCENES["needles"] = lambda: (stretched_hand(2000, sigma_mm=(1, 2), aspect=20), camera_for(128, 84))


def test_gradients_of_the_smooth_variant_agree_with_finite_differences():
    """Promise 1, in units in which a covariance is a number of ordinary size."""
    some, camera = stretched_hand(5, sigma_mm=(3, 14), opacity=(0.1, 0.95), seed=2), camera_for(8, 6)
    sigma_m = in_precision(some, torch.float64).sigma_m

    def planes(position_m, covariance_mm2, opacity, rgb):
        gaussians = Gaussians(position_m, sigma_m, opacity, rgb, 1e-6 * covariance_mm2)
        return planes_of(rasterize_reference(gaussians, camera, smooth=True))

    assert some.covariance_m2 is not None
    leaves = in_precision(replace(some, covariance_m2=1e6 * some.covariance_m2), torch.float64, grad=True)
    inputs = tuple(getattr(leaves, name) for name in ELLIPSOID_NAMES)
    assert torch.autograd.gradcheck(planes, inputs, eps=1e-6, atol=1e-5, rtol=1e-3)


# ---- the kernel against the reference -------------------------------------------------------------------------------


@every_backend
@pytest.mark.parametrize("scene", SCENES)
def test_the_picture_agrees_with_the_reference(scene, backend):
    gaussians, camera = SCENES[scene]()
    got, want = draw(gaussians, camera, backend), exact(gaussians, camera)
    assert_same_picture(got, want, depth_scale_m=0.8)
    assert (got.visible_gaussians, got.invalid_gaussians) == (want.visible_gaussians, 0)


# promised: relative L2 1e-3, cosine gap 1e-5, signed bias 1e-4. Worst observed over all scenes and variants when no
# pixel stops early: 1.6e-4, 6.9e-5, 2.3e-9 and 5.1e-5; with the contract's early stop: 9.2e-4, 8.7e-4, 3.7e-7 and
# 1.1e-4 (many layers of opaque needles: 5.1e-4, the stop cuts all their tails on the same side)
WHOLE = GradientBounds(element=1.7e-4, relative_l2=7.3e-5, cosine_gap=2.5e-9, signed_bias=5.4e-5)
STOPPED = GradientBounds(element=9.7e-4, relative_l2=9.2e-4, cosine_gap=3.9e-7, signed_bias=1.2e-4)


@with_gradients
@pytest.mark.parametrize("scene", SCENES)
def test_gradients_agree_with_the_reference(scene, backend):
    gaussians, camera = SCENES[scene]()
    want = gradients_of(gaussians, camera, dtype=torch.float64)
    got = gradients_of(gaussians, camera, backend=backend, t_stop=0.0)
    assert_same_gradients(got, want, WHOLE, ELLIPSOID_NAMES)
    if backend != "torch" and scene != "needles":  # the reference never stops
        assert_same_gradients(gradients_of(gaussians, camera, backend=backend), want, STOPPED, ELLIPSOID_NAMES)


# ---- spheres as ellipsoids ------------------------------------------------------------------------------------------


@every_backend
def test_round_covariances_draw_the_picture_of_spheres(backend):
    gaussians, camera = hand_gaussians(5000, sigma_mm=(0.5, 2)), camera_for(160, 104)
    got, want = draw(as_ellipsoids(gaussians), camera, backend), draw(gaussians, camera, backend)
    assert_same_picture(got, want, depth_scale_m=0.7)
    assert got.visible_gaussians == want.visible_gaussians


@with_gradients
def test_round_covariances_have_the_gradients_of_spheres(backend):
    gaussians, camera = hand_gaussians(2000, sigma_mm=(1, 2)), camera_for(96, 64)
    position, covariance, *rest = gradients_of(as_ellipsoids(gaussians), camera, backend=backend)
    sigma = 2 * gaussians.sigma_m * covariance[:, [0, 3, 5]].sum(1)
    want = gradients_of(gaussians, camera, backend=backend)
    assert_same_gradients([position, sigma, *rest], want, WHOLE)


@every_backend
def test_sigma_is_ignored_where_there_are_covariances(backend):
    gaussians, camera = stretched_hand(300, sigma_mm=(2, 3)), camera_for(40, 30)
    other = replace(gaussians, sigma_m=torch.full_like(gaussians.sigma_m, math.nan))
    got, want = draw(other, camera, backend), draw(gaussians, camera, backend)
    assert_same_bits(got, want)
    assert got.invalid_gaussians == 0


# ---- threads, order, culling ----------------------------------------------------------------------------------------


@with_gradients
@pytest.mark.parametrize("flat", ["disk", "needle"])
def test_flat_gaussians_are_drawn_from_every_side(flat, backend):
    """Disks and needles without any thickness: edge-on their ellipse is a line, whichever way its rounding went."""
    count = 300
    generator = torch.Generator().manual_seed(3)
    log_scale = torch.full((count, 3), math.log(5e-3))
    log_scale[:, : 1 if flat == "disk" else 2] = -40.0
    turn = torch.randn(count, 4, generator=generator)
    covariance = posed_covariance(log_scale, turn, torch.eye(3).expand(count, 3, 3))
    hand = replace(hand_gaussians(count), covariance_m2=covariance)
    # the first ones exactly edge-on or along the ray
    axes = torch.tensor([[0, 0, 0, 25e-6, 0, 25e-6], [25e-6, 0, 0, 0, 0, 25e-6], [0, 0, 0, 0, 0, 25e-6]])
    covariance[:3] = axes
    hand.position_m[:3] = torch.tensor([0.0, 0.0, 0.0])
    hand.position_m[:, 2] += 0.6
    camera = front_camera(96, 64, 200.0)
    got, want = draw(hand, camera, backend), exact(hand, camera)
    assert got.visible_gaussians == want.visible_gaussians > 0.9 * count
    assert got.invalid_gaussians == 0
    assert_same_picture(got, want, depth_scale_m=0.7)
    gradients = gradients_of(hand, camera, backend=backend)
    assert all(bool(torch.isfinite(gradient).all()) for gradient in gradients)


@every_backend
def test_a_huge_needle_beyond_flat_is_the_needle(backend):
    """Where rounding is many pixels large: without the clamp, alpha would grow along the needle, not fall."""
    deviation = 1732 / 500  # 1732 px, seen from 1 m
    beyond = 1 + 1.5e-6  # the correlation of x and y
    needle = gaussians_from([[-2100 / 500, -2100 / 500, 1]], [1.0], [0.5], [[1, 1, 1]])
    covariance = deviation**2 * torch.tensor([[1.0, beyond, 0, 1.0, 0, 0]])
    camera = front_camera(9, 9, 500.0)
    picture = draw(replace(needle, covariance_m2=covariance), camera, backend)
    assert picture.visible_gaussians == 1
    want = 0.5 * math.exp(-0.5 * 2 * 2100**2 / (2 * 1732**2))
    # float32 resolves the exponent to 0.2 here
    assert float(picture.alpha[4, 4]) == pytest.approx(want, rel=0.4)
    assert float(picture.alpha[0, 8]) < float(picture.alpha[4, 4])
    round_off = rasterize_reference(
        in_precision(replace(needle, covariance_m2=covariance), torch.float64), front_camera(9, 9, 500.0)
    )
    assert float(round_off.alpha[4, 4]) == pytest.approx(want, rel=1e-3)


# ---- errors ---------------------------------------------------------------------------------------------------------


@every_backend
def test_wrong_covariances_are_refused_by_name(backend):
    good = stretched_hand(10)
    covariance = good.covariance_m2
    assert covariance is not None
    for wrong in (covariance[:9], covariance[:, :5], covariance.reshape(-1), covariance.double(), [1.0] * 6):
        with pytest.raises(InputError, match="covariance_m2"):
            draw(replace(good, covariance_m2=wrong), camera_for(8, 8), backend)  # type: ignore[arg-type]
