"""Poison and chance: whatever stands in the tensors, the picture and the gradients stay finite (promises 10 and 11)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from splat_scenes import (
    NAMES,
    NATIVE,
    draw,
    front_camera,
    gaussians_from,
    hand_gaussians,
    in_precision,
    planes_of,
)

from jghand_engine.avatar.gaussians import Gaussians
from jghand_engine.errors import InputError
from jghand_engine.splat.camera import Camera
from jghand_engine.splat.picture import Picture

BACKENDS = ["torch", *NATIVE]
every_backend = pytest.mark.parametrize("backend", BACKENDS)

POISON = (
    *(math.nan, math.inf, -math.inf, 3.4e38, -3.4e38, 1e30, -1e30, 1e10, -1e10, 1e-38, 1e-45),
    *(0.0, -0.0, -1.0, 1e6, 1 / 255, 1 / 255 - 1e-6, 1 / 255 + 1e-6, 0.01, 1.0, 1 + 1e-6, 2.0),
)
SLOTS = [(name, column) for name in NAMES for column in range(3 if name in ("position_m", "rgb") else 1)]


def front_hand(count: int) -> Gaussians:
    hand = hand_gaussians(count, sigma_mm=(2, 5))
    hand.position_m[:, 2] += 0.6
    return hand


def draw_and_differentiate(gaussians: Gaussians, camera: Camera, backend: str) -> tuple[Picture, list[torch.Tensor]]:
    leaves = in_precision(gaussians, torch.float32, grad=True)
    picture = draw(leaves, camera, backend)
    planes_of(picture).sum().backward()
    return detached(picture), [getattr(leaves, name).grad for name in NAMES]


def detached(picture: Picture) -> Picture:
    tensors = {name: getattr(picture, name).detach() for name in ("rgb", "alpha", "depth_sum")}
    return replace(picture, **tensors)


def assert_finite(picture: Picture, gradients: list[torch.Tensor], what: str) -> None:
    assert bool(torch.isfinite(planes_of(picture)).all()), f"picture: {what}"
    for name, gradient in zip(NAMES, gradients, strict=True):
        assert gradient is None or bool(torch.isfinite(gradient).all()), f"gradient of {name}: {what}"


@every_backend
@pytest.mark.parametrize(("name", "column"), SLOTS)
def test_poisoned_values_never_reach_picture_or_gradients(name, column, backend):
    """Promise 10: 22 values in every input slot."""
    camera = front_camera(64, 48, 200.0)
    for value in POISON:
        hand = front_hand(600)
        tensor = getattr(hand, name)
        (tensor if tensor.ndim == 1 else tensor[:, column])[::7] = value
        assert_finite(*draw_and_differentiate(hand, camera, backend), f"{name}[{column}] = {value}")


@pytest.mark.parametrize(("name", "column"), SLOTS)
def test_every_backend_counts_the_same_invalid_gaussians(name, column):
    camera = front_camera(64, 48, 200.0)
    for value in POISON:
        hand = front_hand(300)
        tensor = getattr(hand, name)
        (tensor if tensor.ndim == 1 else tensor[:, column])[::7] = value
        pictures = [draw(hand, camera, backend) for backend in BACKENDS]
        counts = {(picture.visible_gaussians, picture.invalid_gaussians) for picture in pictures}
        assert len(counts) == 1, f"{name}[{column}] = {value}: {counts}"


INVALID = {
    "position_m": [math.nan, math.inf, -math.inf, 3.4e38, 1.1e6],
    "sigma_m": [math.nan, math.inf, 0.0, -0.0, -1.0, 1e10],
    "opacity": [math.nan, math.inf, -1.0, 1 + 1e-6, 2.0],
    "rgb": [math.nan, -math.inf, 1.1e6, -3.4e38],
}


@every_backend
@pytest.mark.parametrize("name", NAMES)
def test_what_the_contract_calls_invalid_is_counted_and_has_no_gradient(name, backend):
    camera = front_camera(64, 48, 200.0)
    for value in INVALID[name]:
        hand = front_hand(50)
        tensor = getattr(hand, name)
        (tensor if tensor.ndim == 1 else tensor[:, 0])[11] = value
        picture, gradients = draw_and_differentiate(hand, camera, backend)
        assert picture.invalid_gaussians == 1, value
        assert all(float(gradient[11].abs().sum()) == 0 for gradient in gradients), value


SIZES = [(1, 1), (2, 1), (3, 5), (4, 4), (7, 16), (16, 16), (17, 31), (33, 8), (64, 48), (100, 3), (5, 120)]


@pytest.mark.parametrize("backend", NATIVE)
def test_200_random_scenes_keep_the_invariants(backend):
    """Promise 11: up to 95 % of the values poisoned, eleven picture sizes."""
    random = np.random.default_rng(11)
    for scene in range(200):
        count, rate = int(random.integers(0, 400)), float(random.uniform(0, 0.95))
        hand = front_hand(count)
        for name in NAMES:
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
def test_a_gaussian_at_the_camera_centre_is_culled(backend):
    picture, gradients = draw_and_differentiate(
        gaussians_from([[0, 0, 0], [1e-20, 0, 1e-20]], [1e-3] * 2, [0.9] * 2, [[1, 1, 1]] * 2),
        front_camera(9, 9, 50.0),
        backend,
    )
    assert picture.visible_gaussians == 0
    assert_finite(picture, gradients, "camera centre")


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


@pytest.mark.parametrize("value", [math.nan, math.inf, 0.0, -1.0])
def test_a_camera_without_a_focal_length_is_refused(value):
    with pytest.raises(InputError, match="fx"):
        Camera(8, 8, value, 10.0, 4.0, 4.0, torch.eye(4))
