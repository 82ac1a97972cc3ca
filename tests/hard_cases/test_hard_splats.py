"""Poison and chance: whatever stands in the tensors, the picture and the gradients stay finite (promises 10 and 11)."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from graphics_card import missing
from splat_scenes import (
    DRAWING,
    NATIVE,
    changed,
    draw,
    front_camera,
    gaussians_from,
    hand_gaussians,
    in_precision,
    names_of,
    planes_of,
    stretched,
)

from jghand_engine.errors import InputError
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.reference import Picture
from jghand_engine.native.library import GPU
from jghand_engine.render.camera import Camera

every_backend = pytest.mark.parametrize("backend", ["torch", *DRAWING])

POISON = (
    *(math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e30, -1e30, 1e10, -1e10, 1e-38, 1e-45),
    *(0.0, -0.0, -1.0, 1e6, 1 / 255, 1 / 255 - 1e-6, 1 / 255 + 1e-6, 0.01, 1.0, 1 + 1e-6, 2.0),
)
COLUMNS = {"position_m": 3, "sigma_m": 1, "opacity": 1, "rgb": 3, "covariance_m2": 6}
SLOTS = [(name, column) for name, columns in COLUMNS.items() for column in range(columns)]


def front_hand(count: int, *, ellipsoids: bool = False) -> Gaussians:
    hand = hand_gaussians(count, sigma_mm=(2, 5))
    hand.position_m[:, 2] += 0.6
    return stretched(hand) if ellipsoids else hand


def hand_with(name: str, count: int) -> Gaussians:
    """One that has the tensor `name`."""
    return front_hand(count, ellipsoids=name == "covariance_m2")


def draw_and_differentiate(gaussians: Gaussians, camera: Camera, backend: str) -> tuple[Picture, list[torch.Tensor]]:
    if backend == GPU:  # draws only
        return draw(gaussians, camera, backend), []
    leaves = in_precision(gaussians, torch.float32, grad=True)
    picture = draw(leaves, camera, backend)
    planes_of(picture).sum().backward()
    return detached(picture), [getattr(leaves, name).grad for name in names_of(leaves)]


def detached(picture: Picture) -> Picture:
    tensors = {name: getattr(picture, name).detach() for name in ("rgb", "alpha", "depth_sum")}
    return replace(picture, **tensors)


def assert_finite(picture: Picture, gradients: list[torch.Tensor], what: str) -> None:
    assert bool(torch.isfinite(planes_of(picture)).all()), f"picture: {what}"
    for place, gradient in enumerate(gradients):
        assert gradient is None or bool(torch.isfinite(gradient).all()), f"gradient {place}: {what}"


@pytest.mark.parametrize(("name", "column"), SLOTS)
def test_poisoned_values_never_reach_picture_or_gradients_and_every_backend_counts_the_same(name, column):
    """Promise 10: 22 values in every input slot."""
    camera = front_camera(32, 24, 100.0)
    for value in POISON:
        hand, what, counts = hand_with(name, 200), f"{name}[{column}] = {value}", set()
        tensor = getattr(hand, name)
        (tensor if tensor.ndim == 1 else tensor[:, column])[::7] = value
        for backend in ("torch", *NATIVE, *([] if missing() else [GPU])):
            picture, gradients = draw_and_differentiate(hand, camera, backend)
            assert_finite(picture, gradients, f"{what}, {backend}")
            counts.add((picture.visible_gaussians, picture.invalid_gaussians))
        assert len(counts) == 1, f"{what}: {counts}"


INVALID = {
    "position_m": [math.nan, math.inf, -math.inf, 3.4e38, 1.1e6],
    "sigma_m": [math.nan, math.inf, 0.0, -0.0, -1.0, 1e10],
    "opacity": [math.nan, math.inf, -1.0, 1 + 1e-6, 2.0],
    "rgb": [math.nan, -math.inf, 1.1e6, -3.4e38],
    "covariance_m2": [math.nan, math.inf, -1.0, -1e-8, 1e30],
}


@every_backend
@pytest.mark.parametrize("name", COLUMNS)
def test_what_the_contract_calls_invalid_is_counted_and_has_no_gradient(name, backend):
    camera = front_camera(64, 48, 200.0)
    for value in INVALID[name]:
        hand = hand_with(name, 50)
        tensor = getattr(hand, name)
        (tensor if tensor.ndim == 1 else tensor[:, 0])[11] = value
        picture, gradients = draw_and_differentiate(hand, camera, backend)
        assert picture.invalid_gaussians == 1, value
        assert all(float(gradient[11].abs().sum()) == 0 for gradient in gradients), value


NOT_SEMI_DEFINITE = {
    "nothing": [0, 0, 0, 0, 0, 0],
    "a negative variance": [1e-6, 0, 0, 1e-6, 0, -1e-9],
    "two negative variances": [-1e-6, 0, 0, -1e-6, 0, 1e-5],
    "xy too large": [1e-6, 1.01e-6, 0, 1e-6, 0, 1e-6],
    "xz too large": [1e-6, 0, 1.01e-6, 1e-6, 0, 1e-6],
    "yz too large": [1e-6, 0, 0, 1e-6, 1.01e-6, 1e-6],
    "all three too large together": [1e-6, -0.6e-6, -0.6e-6, 1e-6, -0.6e-6, 1e-6],
    "beyond rounding": [1e-6, 0, 0, 1e-6, 0, -3e-12],
}


@every_backend
@pytest.mark.parametrize("what", NOT_SEMI_DEFINITE)
def test_a_covariance_that_is_none_is_counted_and_changes_nothing_else(what, backend):
    camera, hand = front_camera(64, 48, 200.0), front_hand(50, ellipsoids=True)
    assert hand.covariance_m2 is not None
    hand.covariance_m2[11] = torch.tensor(NOT_SEMI_DEFINITE[what])
    picture, gradients = draw_and_differentiate(hand, camera, backend)
    assert picture.invalid_gaussians == 1
    assert all(float(gradient[11].abs().sum()) == 0 for gradient in gradients)
    kept = torch.arange(50) != 11
    without = changed(hand, lambda name: getattr(hand, name)[kept].contiguous())
    assert torch.equal(planes_of(picture), planes_of(draw(without, camera, backend)))


SIZES = [(1, 1), (2, 1), (3, 5), (4, 4), (7, 16), (16, 16), (17, 31), (33, 8), (64, 48), (100, 3), (5, 120)]


@pytest.mark.parametrize("backend", DRAWING)
def test_random_scenes_keep_the_invariants(backend):
    """Promise 11: up to 95 % of the values poisoned, eleven picture sizes."""
    random = np.random.default_rng(11)
    for scene in range(100):
        count, rate = int(random.integers(0, 400)), float(random.uniform(0, 0.95))
        hand = front_hand(count, ellipsoids=scene % 2 == 1)
        for name in names_of(hand):
            tensor = getattr(hand, name)
            poisoned = torch.from_numpy(random.uniform(size=tuple(tensor.shape)) < rate)
            values = torch.from_numpy(random.choice(POISON, size=tuple(tensor.shape))).float()
            tensor[poisoned] = values[poisoned]
        width, height = SIZES[scene % len(SIZES)]
        picture, gradients = draw_and_differentiate(hand, front_camera(width, height, 150.0), backend)
        assert_finite(picture, gradients, f"scene {scene}")
        assert picture.visible_gaussians + picture.invalid_gaussians <= count
        assert -1e-6 <= float(picture.alpha.min()) <= float(picture.alpha.max()) <= 1 + 1e-6
        assert tuple(picture.rgb.shape) == (height, width, 3)


@every_backend
def test_a_gaussian_at_the_camera_center_is_culled(backend):
    picture, gradients = draw_and_differentiate(
        gaussians_from([[0, 0, 0], [1e-20, 0, 1e-20]], [1e-3] * 2, [0.9] * 2, [[1, 1, 1]] * 2),
        front_camera(9, 9, 50.0),
        backend,
    )
    assert picture.visible_gaussians == 0
    assert_finite(picture, gradients, "camera center")


@every_backend
def test_long_thin_ellipses_at_the_near_plane_stay_finite(backend):
    """Far off the axis and just in front of the camera, det = a c - b^2 cancels when it is computed that way."""
    random = np.random.default_rng(12)
    position = np.stack([random.uniform(-0.3, 0.3, 500), random.uniform(-0.3, 0.3, 500), np.full(500, 0.0101)], 1)
    rgb = random.uniform(0, 1, (500, 3))
    hand = gaussians_from(position, random.uniform(1e-4, 0.3, 500), random.uniform(0.1, 1, 500), rgb)
    picture, gradients = draw_and_differentiate(hand, front_camera(64, 48, 100.0), backend)
    assert picture.visible_gaussians > 100
    assert_finite(picture, gradients, "near plane")


@every_backend
@pytest.mark.parametrize("aspect", [1e2, 1e4, 1e8])
def test_needles_and_flakes_of_any_size_stay_finite(aspect, backend):
    """Up to kilometers long, and from the near plane to the far: beyond what float32 resolves across them."""
    hand = stretched(front_hand(600), aspect=aspect)
    hand.position_m[::2, 2] = torch.linspace(0.0101, 5, 300)
    picture, gradients = draw_and_differentiate(hand, front_camera(64, 48, 300.0), backend)
    assert picture.visible_gaussians > 100
    assert -1e-6 <= float(picture.alpha.min()) <= float(picture.alpha.max()) <= 1 + 1e-6
    assert_finite(picture, gradients, f"aspect {aspect}")


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -1.0])
def test_a_camera_without_a_focal_length_is_refused(value):
    with pytest.raises(InputError, match="fx"):
        Camera(8, 8, value, 10.0, 4.0, 4.0, np.eye(4))
