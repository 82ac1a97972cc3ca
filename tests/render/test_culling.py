"""What the reference draws and what it leaves out: where the border is, on the picture, of a tile and of a value."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from splat_scenes import as_ellipsoids, camera_for, front_camera, hand_gaussians, in_precision, planes_of, reordered

from jghand_engine.errors import InputError
from jghand_engine.learn import reference
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import check_gaussians, rasterize_reference, semi_definite
from jghand_engine.native import contract
from jghand_engine.render.camera import Camera

F64 = torch.float64


def one(position_m, *, sigma_m: float = 1e-3, opacity: float = 0.5, rgb=(1.0, 1.0, 1.0)) -> Gaussians:
    """One Gaussian, in float64 to the last bit."""
    rows = ([position_m], [sigma_m], [opacity], [rgb])
    return Gaussians(*(torch.tensor(row, dtype=F64) for row in rows))


def counts(gaussians: Gaussians, camera: Camera) -> tuple[int, int]:
    picture = rasterize_reference(gaussians, camera)
    return picture.visible_gaussians, picture.invalid_gaussians


# ---- the picture's border -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_gaussian_is_drawn_while_its_box_reaches_into_the_picture(side: str):
    """The box is where alpha falls to the cut: sigma sqrt(2 ln(opacity / cut)), with the low pass (RENDERING 3)."""
    camera = Camera(20, 12, 100.0, 160.0, 10.0, 6.0, torch.eye(4, dtype=F64))
    sigma_m, opacity, k = 0.02, 0.7, 2 * math.log(0.7 * 255)
    for inside, drawn in ((0.01, 1), (-0.01, 0)):
        # on the axis across the side the projection's slant adds to the variance: solve for the center by iteration
        x, y = 0.0, 0.0
        for _ in range(50):
            reach_x = math.sqrt(k * ((sigma_m * 100) ** 2 * (1 + x * x) + 0.3))
            reach_y = math.sqrt(k * ((sigma_m * 160) ** 2 * (1 + y * y) + 0.3))
            match side:
                case "left":
                    x = (-reach_x + inside - 10) / 100
                case "right":
                    x = (20 + reach_x - inside - 10) / 100
                case "top":
                    y = (-reach_y + inside - 6) / 160
                case "bottom":
                    y = (12 + reach_y - inside - 6) / 160
        assert counts(one([x, y, 1.0], sigma_m=sigma_m, opacity=opacity), camera) == (drawn, 0)


# ---- values at their limits -----------------------------------------------------------------------------------------


def test_at_the_near_plane_nothing_is_drawn_and_right_behind_it_is():
    camera = front_camera(16, 16, 20.0)
    for depth_m, drawn in ((contract.Z_NEAR_M, 0), (math.nextafter(contract.Z_NEAR_M, 1), 1)):
        assert counts(one([0.0, 0.0, depth_m]), camera) == (drawn, 0)


def test_an_opacity_equal_to_the_cut_cannot_be_seen():
    camera = front_camera(15, 15, 20.0)
    for opacity, drawn in ((contract.ALPHA_MIN, 0), (math.nextafter(contract.ALPHA_MIN, 1), 1)):
        assert counts(one([0.0, 0.0, 1.0], opacity=opacity), camera) == (drawn, 0)


def test_a_variance_equal_to_its_limit_is_invalid(monkeypatch):
    """Of spheres in the middle of the picture the variance is (sigma f / z)^2 + 0.3, in both directions."""
    camera = Camera(9, 9, 1.0, 2.0, 4.5, 4.5, torch.eye(4, dtype=F64))
    for limit, drawn in ((4.3, 0), (math.nextafter(4.3, 5), 1), (1.3, 0), (2.0, 0)):
        monkeypatch.setattr(contract, "VAR_MAX_PX2", limit)
        assert counts(one([0.0, 0.0, 1.0], sigma_m=1.0), camera) == (drawn, 1 - drawn)
        turned = Camera(9, 9, 2.0, 1.0, 4.5, 4.5, torch.eye(4, dtype=F64))
        assert counts(one([0.0, 0.0, 1.0], sigma_m=1.0), turned) == (drawn, 1 - drawn)


def test_the_largest_values_that_can_be_drawn_are_drawn():
    far, bright = contract.POSITION_MAX_M, contract.RGB_MAX
    camera = Camera(9, 9, 1.0, 1.0, 4.5, 4.5, torch.eye(4, dtype=F64))
    largest = one([far, -far, far], sigma_m=1e3, opacity=1.0, rgb=(bright, -bright, 0.0))
    assert counts(largest, replace(camera, cx=3.5, cy=5.5)) == (1, 0)
    faint = replace(largest, opacity=torch.zeros(1, dtype=F64))
    assert counts(faint, camera) == (0, 0)


BOTH_WAYS = list(itertools.product(range(3), (1, -1)))


@pytest.mark.parametrize(
    ("name", "column", "value"),
    [
        *(("position_m", column, sign * math.nextafter(contract.POSITION_MAX_M, 2e6)) for column, sign in BOTH_WAYS),
        *(("rgb", column, sign * math.nextafter(contract.RGB_MAX, 2e6)) for column, sign in BOTH_WAYS),
        ("sigma_m", None, 0.0),
        ("sigma_m", None, math.inf),
        ("opacity", None, math.nextafter(1, 2)),
        ("opacity", None, -5e-324),
    ],
)
def test_one_value_beyond_its_limit_makes_one_gaussian_invalid(name, column, value):
    hand = in_precision(hand_gaussians(20, sigma_mm=(2, 3)), F64)
    camera = camera_for(24, 16)
    visible = counts(hand, camera)[0]
    tensor = getattr(hand, name)
    (tensor if column is None else tensor[:, column])[7] = value
    picture = rasterize_reference(hand, camera)
    assert (picture.visible_gaussians, picture.invalid_gaussians) == (visible - 1, 1)
    without = rasterize_reference(reordered(hand, torch.arange(20) != 7), camera)
    assert torch.equal(planes_of(picture), planes_of(without))


# ---- covariances ----------------------------------------------------------------------------------------------------


def upper(matrices: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(matrices.reshape(-1, 9)[:, [0, 1, 2, 4, 5, 8]].copy())


def test_semi_definite_is_what_the_eigenvalues_say():
    random = np.random.default_rng(0)
    full = random.normal(size=(4000, 3, 3)) * 10.0 ** random.uniform(-8, 3, (4000, 1, 1))
    symmetric = full + full.swapaxes(1, 2) + np.abs(np.linalg.norm(full, axis=(1, 2)))[:, None, None] * np.eye(3)
    trace = np.trace(symmetric, axis1=1, axis2=2)
    least = np.linalg.eigvalsh(symmetric)[:, 0] + contract.COVARIANCE_SLACK * trace
    expected = least > 0
    assert 0.2 < expected.mean() < 0.8
    assert np.array_equal(semi_definite(upper(symmetric)).numpy(), expected)


def test_flat_covariances_may_be_a_part_of_their_trace_beyond_flat():
    random = np.random.default_rng(1)
    turn = np.linalg.qr(random.normal(size=(200, 3, 3)))[0]
    for part, good in ((-0.9, True), (-1.1, False)):
        for flat in ([2.0, 1.0, 0.0], [3.0, 0.0, 0.0]):
            values = np.array(flat) + part * contract.COVARIANCE_SLACK * sum(flat) * (np.array(flat) == 0)
            matrices = turn * values @ turn.swapaxes(1, 2)
            assert (semi_definite(upper(matrices)).numpy() == good).all()


# ---- alpha at the cut and at the cap --------------------------------------------------------------------------------


def test_the_smooth_cut_is_a_smoothstep_from_the_cut_to_twice_the_cut():
    cut = 0.01
    alpha = torch.tensor([0.0, 0.005, 0.01, 0.0125, 0.015, 0.0175, 0.02, 0.03, 0.9], dtype=F64)
    steps = torch.tensor([0, 0, 0, 0.15625, 0.5, 0.84375, 1, 1, 1], dtype=F64)
    torch.testing.assert_close(reference._cut(alpha, cut, smooth=True), alpha * steps, rtol=1e-12, atol=1e-15)
    hard = torch.tensor([0, 0, 0.01, 0.0125, 0.015, 0.0175, 0.02, 0.03, 0.9], dtype=F64)
    assert torch.equal(reference._cut(alpha, cut, smooth=False), hard)


def test_an_alpha_at_the_cap_has_no_gradient_and_one_below_it_has():
    for opacity, gradient in ((contract.ALPHA_MAX, 0.0), (math.nextafter(contract.ALPHA_MAX, 0), 1.0)):
        leaf = torch.tensor([opacity], dtype=F64, requires_grad=True)
        gaussian = replace(one([0.0, 0.0, 1.0]), opacity=leaf)
        rasterize_reference(gaussian, front_camera(5, 5, 100.0)).alpha[2, 2].backward()
        assert leaf.grad is not None
        assert float(leaf.grad) == gradient


# ---- shapes ---------------------------------------------------------------------------------------------------------


def test_gaussians_of_wrong_kind_shape_type_or_device_are_named():
    good = as_ellipsoids(hand_gaussians(4))
    check_gaussians(good)
    check_gaussians(in_precision(good, F64))
    check_gaussians(hand_gaussians(0))
    for name, wrong, message in (
        ("position_m", torch.tensor(1.0), r"position_m: wanted shape \(N, 3\)"),
        ("position_m", torch.zeros(4, 2), r"position_m: wanted shape \(N, 3\)"),
        ("sigma_m", torch.zeros(5), r"sigma_m: wanted shape \(4,\)"),
        ("opacity", torch.zeros(4, 1), r"opacity: wanted shape \(4,\)"),
        ("rgb", torch.zeros(4, 4), r"rgb: wanted shape \(4, 3\)"),
        ("covariance_m2", torch.zeros(4, 7), r"covariance_m2: wanted shape \(4, 6\)"),
        ("rgb", torch.zeros(4, 3, dtype=torch.float16), "rgb: wanted dtype float32 or float64"),
        ("opacity", torch.zeros(4, dtype=F64), "opacity: wanted torch.float32 on cpu"),
        ("opacity", torch.zeros(4, device="meta"), "opacity: wanted torch.float32 on cpu"),
        ("sigma_m", [1.0], "sigma_m: wanted a torch tensor"),
    ):
        with pytest.raises(InputError, match=message):
            check_gaussians(replace(good, **{name: wrong}))  # type: ignore[arg-type]
