"""The light of a capture: harmonics, what falls on the skin, what it reflects."""

import math
from dataclasses import replace

import numpy as np
import pytest
import scipy.special
import torch

from jghand_engine.avatar.learned import LIGHT_EXPONENT_MAX, SH_COUNT
from jghand_engine.learn.light import LightTensors, gloss, harmonics, lit, unit


def directions(count: int = 200, seed: int = 0) -> torch.Tensor:
    """(N, 3) unit, float64: random ones and both ends of every axis."""
    some = torch.randn(count, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))
    axes = torch.eye(3, dtype=torch.float64)
    return torch.cat([torch.nn.functional.normalize(some, dim=-1), axes, -axes])


def random(*shape: int, seed: int = 9) -> torch.Tensor:
    """0..1, float64."""
    return torch.rand(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def light_with(**parts: torch.Tensor) -> LightTensors:
    """Darkness but for `parts`."""
    dark = LightTensors(
        irradiance=torch.zeros(SH_COUNT, 3),
        lobe_direction=torch.tensor([[0.0, 0.0, 1.0]]),
        lobe_sharpness=torch.tensor([20.0]),
        lobe_rgb=torch.zeros(1, 3),
        rim=torch.tensor(0.0),
    )
    return replace(dark, **parts).to(torch.float64)


def random_light(seed: int = 0) -> LightTensors:
    g = torch.Generator().manual_seed(seed)
    return light_with(
        irradiance=0.2 * torch.randn(SH_COUNT, 3, generator=g),
        lobe_direction=torch.randn(4, 3, generator=g),
        lobe_sharpness=2 + 10 * torch.rand(4, generator=g),
        lobe_rgb=torch.rand(4, 3, generator=g),
        rim=torch.tensor(0.6),
    )


# ---- harmonics -------------------------------------------------------------------------------------------------------


def real_harmonic(degree: int, order: int, at: np.ndarray) -> np.ndarray:
    """(N,) by scipy, for unit vectors (N, 3); cosine for order >= 0, sine below."""
    polar, azimuth = np.arccos(np.clip(at[:, 2], -1, 1)), np.arctan2(at[:, 1], at[:, 0])
    if hasattr(scipy.special, "sph_harm_y"):
        value = scipy.special.sph_harm_y(degree, abs(order), polar, azimuth)
    else:
        value = scipy.special.sph_harm(abs(order), degree, azimuth, polar)
    return np.real(value) if order >= 0 else np.imag(value)


# degree and order of each column
ORDER = [
    (0, 0), (1, 1), (1, -1), (1, 0), (2, -2), (2, -1), (2, 1), (2, 2), (2, 0),
    (3, -3), (3, -2), (3, -1), (3, 0), (3, 1), (3, 2), (3, 3),
]  # fmt: skip


@pytest.mark.parametrize("column", range(SH_COUNT))
def test_a_harmonic_is_that_of_the_books_up_to_a_constant(column):
    at = directions()
    ours, books = harmonics(at)[:, column].numpy(), real_harmonic(*ORDER[column], at.numpy())
    constant = float(ours @ books) / float(books @ books)
    # worst seen, of values up to 2: 9e-15, and 4e-14 of 5000 directions
    assert np.abs(ours - constant * books).max() < 5e-14
    assert abs(constant) > 0.4


# ---- matt skin -------------------------------------------------------------------------------------------------------


def test_matt_color_is_albedo_times_the_exponential_of_the_harmonics():
    light, normal = random_light(), directions()
    albedo = random(len(normal), 3)
    shade = 0.2 * random(len(normal), 3, seed=10) - 0.1
    wanted = albedo * torch.exp(harmonics(normal) @ light.irradiance + shade)
    torch.testing.assert_close(lit(albedo, normal, light, shade), wanted)


def test_light_and_shade_together_stay_within_the_exponents_limit():
    normal, albedo = directions(), torch.ones(206, 3, dtype=torch.float64)
    strong = light_with(irradiance=100 * torch.randn(SH_COUNT, 3, generator=torch.Generator().manual_seed(1)))
    shade = 50.0 * torch.ones(206, 3, dtype=torch.float64)
    for extra in (None, shade, -shade):
        got = lit(albedo, normal, strong, extra).log()
        torch.testing.assert_close(got.abs().max(), torch.tensor(LIGHT_EXPONENT_MAX, dtype=torch.float64))
    assert bool(torch.isfinite(lit(albedo, normal, strong, 1e30 * shade)).all())


# ---- gloss -----------------------------------------------------------------------------------------------------------


def test_gloss_is_brightest_where_the_mirrored_direction_meets_the_lobe():
    """The normal half way between eye and lamp."""
    lamp = unit(torch.tensor([0.3, 0.5, 0.8], dtype=torch.float64))
    light = light_with(lobe_direction=7 * lamp[None].float(), lobe_rgb=torch.tensor([[0.9, 0.6, 0.3]]))
    eye = unit(torch.tensor([-0.4, 0.2, 0.9], dtype=torch.float64))
    half = unit(lamp + eye)
    at_peak = gloss(half[None], eye[None], light)[0]
    # the lobe's own color, to the rounding of its direction, which was given in float32
    torch.testing.assert_close(at_peak, torch.tensor([0.9, 0.6, 0.3]).double(), atol=1e-7, rtol=0)
    around = unit(half + 0.1 * (random(300, 3) - 0.5))
    others = gloss(around, eye.expand(300, 3), light)
    assert bool((others < at_peak).all())
    assert float(others.max()) > 0.5 * float(at_peak.max())


def test_a_lobe_fades_as_a_spherical_gaussian():
    normal = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    light = light_with(lobe_rgb=torch.ones(1, 3), lobe_sharpness=torch.tensor([6.0]))
    for degrees in (0.0, 10.0, 60.0, 90.0):
        angle = math.radians(degrees)
        # mirrored at the normal, this goes as far to the other side
        eye = torch.tensor([[math.sin(angle), 0.0, math.cos(angle)]], dtype=torch.float64)
        assert float(gloss(normal, eye, light)[0, 0]) == pytest.approx(math.exp(6.0 * (math.cos(angle) - 1)))


def test_the_rim_counts_at_grazing_angles_and_not_from_the_front():
    normal = torch.tensor([[0.0, 0.0, 1.0]], dtype=torch.float64)
    plain = light_with(lobe_rgb=torch.ones(1, 3), lobe_sharpness=torch.tensor([0.0]))
    rimmed = replace(plain, rim=torch.tensor(2.0, dtype=torch.float64))
    for degrees, wanted in ((0.0, 1.0), (60.0, 1 + 2 * 0.5**5), (90.0, 3.0), (150.0, 3.0)):
        angle = math.radians(degrees)
        eye = torch.tensor([[math.sin(angle), 0.0, math.cos(angle)]], dtype=torch.float64)
        assert float(gloss(normal, eye, plain)[0, 0]) == pytest.approx(1.0)
        assert float(gloss(normal, eye, rimmed)[0, 0]) == pytest.approx(wanted)


# ---- gradients -------------------------------------------------------------------------------------------------------


def test_gradients_of_light_and_normals_are_those_of_finite_differences():
    light, normal, eye = random_light(), directions(4, 1)[:4], directions(4, 2)[:4]
    parts = [light.irradiance, light.lobe_direction, light.lobe_sharpness, light.lobe_rgb, light.rim]
    albedo, shade = random(4, 3), 0.2 * random(4, 3, seed=10) - 0.1

    def color(normal, eye, albedo, shade, *parts):
        lamps = LightTensors(*parts)
        return lit(albedo, unit(normal), lamps, shade) + gloss(unit(normal), unit(eye), lamps)

    inputs = tuple(tensor.detach().clone().requires_grad_(True) for tensor in (normal, eye, albedo, shade, *parts))
    assert torch.autograd.gradcheck(color, inputs)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize(
    ("normal", "eye"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
        ((1e-30, 0.0, 0.0), (0.0, 1e-30, 0.0)),
        ((0.0, 0.0, 1.0), (1.0, 0.0, 0.0)),
        ((0.0, 0.0, 1.0), (0.0, 0.0, 1.0)),
        ((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)),
        ((1e18, 0.0, 0.0), (0.0, 1e-18, 1e18)),
    ],
    ids=["no normal", "no eye", "neither", "tiny", "grazing", "from the front", "from behind", "huge"],
)
def test_normals_and_views_of_any_kind_have_finite_colors_and_gradients(normal, eye, dtype):
    n = torch.tensor([normal], dtype=dtype, requires_grad=True)
    e = torch.tensor([eye], dtype=dtype, requires_grad=True)
    light = random_light().to(dtype)
    # a lobe without a direction, too
    lobes = light.lobe_direction.clone()
    lobes[0] = 0
    light = replace(light, lobe_direction=lobes.requires_grad_(True))
    albedo = torch.full((1, 3), 0.5, dtype=dtype)
    color = lit(albedo, unit(n), light) + gloss(unit(n), unit(e), light)
    color.sum().backward()
    assert bool(torch.isfinite(color).all())
    for tensor in (n, e, light.lobe_direction):
        assert tensor.grad is not None
        assert bool(torch.isfinite(tensor.grad).all())
