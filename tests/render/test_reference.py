"""The reference against the text of the contract, written down once more, pixel by pixel."""

import math
from dataclasses import replace

import pytest
import torch
from splat_scenes import (
    NAMES,
    camera_for,
    front_camera,
    gaussians_from,
    hand_gaussians,
    in_precision,
    planes_of,
    reordered,
    stretched,
)

from jghand_engine.learn import reference
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import camera_frame, rasterize_reference
from jghand_engine.native import contract


def contract_pixel(gaussians: Gaussians, camera, i: int, j: int, alpha_min: float) -> list[float]:
    """R G B A D of pixel (i, j), literally as RENDERING 3 says it, one Gaussian after the other: the covariance on the
    picture is J R S R^T J^T + 0.3 I."""
    position, turn = camera_frame(gaussians.position_m, camera), torch.from_numpy(camera.camera_from_world[:3, :3])
    transmittance, sums = 1.0, [0.0] * 5
    for n in torch.argsort(position[:, 2], stable=True).tolist():
        x, y, z = position[n].tolist()
        if z <= 0.01:
            continue
        # parallel rays: of the size that they have 1 m away, anywhere
        away, slant = (1.0, 0.0) if camera.orthographic else (z, 1 / z**2)
        rows = [[camera.fx / away, 0, -camera.fx * x * slant], [0, camera.fy / away, -camera.fy * y * slant]]
        jacobian = torch.tensor(rows, dtype=torch.float64) @ turn
        world = float(gaussians.sigma_m[n]) ** 2 * torch.eye(3, dtype=torch.float64)
        if gaussians.covariance_m2 is not None:
            world = gaussians.covariance_m2[n][[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3)
        ellipse = jacobian @ world @ jacobian.T + 0.3 * torch.eye(2, dtype=torch.float64)
        center = (camera.fx * x / away + camera.cx, camera.fy * y / away + camera.cy)
        apart = torch.tensor([i + 0.5 - center[0], j + 0.5 - center[1]], dtype=torch.float64)
        alpha = float(gaussians.opacity[n]) * math.exp(-0.5 * float(apart @ torch.linalg.solve(ellipse, apart)))
        if alpha < alpha_min:
            continue
        weight = min(alpha, 0.999) * transmittance
        transmittance -= weight
        for channel, value in enumerate((*gaussians.rgb[n].tolist(), 1.0, z)):
            sums[channel] += weight * value
    return sums


@pytest.mark.parametrize("shape", [lambda spheres: spheres, stretched], ids=["spheres", "ellipsoids"])
@pytest.mark.parametrize(
    ("alpha_min", "orthographic"), [(contract.ALPHA_MIN, False), (1 / 16384, False), (contract.ALPHA_MIN, True)]
)
def test_every_pixel_is_what_the_contract_says(shape, alpha_min, orthographic):
    gaussians = in_precision(shape(hand_gaussians(60, sigma_mm=(2, 12), opacity=(0.002, 1.0))), torch.float64)
    camera = camera_for(15, 12)
    if orthographic:
        camera = replace(camera, fx=75.0, fy=85.0, cx=6.0, orthographic=True)
    planes = planes_of(rasterize_reference(gaussians, camera, alpha_min=alpha_min))
    worst = max(
        abs(float(planes[channel, j, i]) - value)
        for j in range(camera.height)
        for i in range(camera.width)
        for channel, value in enumerate(contract_pixel(gaussians, camera, i, j, alpha_min))
    )
    assert worst <= 1e-12  # observed 3e-15


def test_one_gaussian_in_the_middle_of_a_pixel_has_its_opacity_there():
    camera = front_camera(5, 5, 100.0)
    picture = rasterize_reference(gaussians_from([[0, 0, 2.0]], [1e-3], [0.5], [[1, 0.5, 0.25]], torch.float64), camera)
    assert picture.alpha[2, 2] == pytest.approx(0.5)
    assert picture.rgb[2, 2].tolist() == pytest.approx([0.5, 0.25, 0.125])
    assert picture.depth_m[2, 2] == pytest.approx(2.0)
    assert float(picture.depth_m[0, 0]) == 0  # nothing there
    assert not bool(picture.valid[0, 0])


def test_y_points_down_and_x_to_the_right():
    picture = rasterize_reference(
        gaussians_from([[0.02, 0.05, 1.0]], [1e-3], [0.9], [[1, 1, 1]], torch.float64), front_camera(21, 21, 100.0)
    )
    row, column = divmod(int(picture.alpha.argmax()), 21)
    assert (column, row) == (12, 15)


def test_gradients_of_the_smooth_variant_agree_with_finite_differences():
    """Promise 1: the hard cut has no finite differences, its C1 variant does."""
    some = hand_gaussians(9, sigma_mm=(3, 14), opacity=(0.1, 0.95), seed=2)
    camera = camera_for(11, 8)

    def planes(*tensors: torch.Tensor) -> torch.Tensor:
        return planes_of(rasterize_reference(Gaussians(*tensors), camera, smooth=True))

    leaves = in_precision(some, torch.float64, grad=True)
    inputs = tuple(getattr(leaves, name) for name in NAMES)
    assert torch.autograd.gradcheck(planes, inputs, eps=1e-6, atol=1e-5, rtol=1e-3)


def test_drawing_in_several_parts_changes_nothing(monkeypatch):
    gaussians = in_precision(hand_gaussians(300, sigma_mm=(2, 4)), torch.float64)
    whole = planes_of(rasterize_reference(gaussians, camera_for(40, 24)))
    monkeypatch.setattr(reference, "REFERENCE_PAIRS_AT_ONCE", 1000)
    parts = planes_of(rasterize_reference(gaussians, camera_for(40, 24)))
    assert float((whole - parts).abs().max()) <= 1e-14  # matrix products of other shapes round differently


def test_equal_depths_follow_the_index():
    both = gaussians_from([[0, 0, 1.0]] * 2, [0.05] * 2, [0.8] * 2, [[1, 0, 0], [0, 1, 0]], torch.float64)
    first = rasterize_reference(both, front_camera(3, 3, 10.0)).rgb[1, 1]
    second = rasterize_reference(reordered(both, torch.tensor([1, 0])), front_camera(3, 3, 10.0)).rgb[1, 1]
    assert first[0] > first[1]
    assert torch.equal(first, second[[1, 0, 2]])


def test_depth_has_a_finite_gradient_where_nothing_is():
    leaves = in_precision(gaussians_from([[0, 0, 1.0]], [1e-3], [0.9], [[1, 1, 1]]), torch.float64, grad=True)
    rasterize_reference(leaves, front_camera(9, 9, 50.0)).depth_m.sum().backward()
    assert leaves.position_m.grad is not None
    assert bool(torch.isfinite(leaves.position_m.grad).all())
