"""The pinhole camera."""

from __future__ import annotations

import pytest
import torch

from jghand_engine.errors import InputError
from jghand_engine.splat.camera import Camera

UP = torch.tensor([0.0, 1.0, 0.0])


def test_the_target_lands_in_the_middle_and_up_is_up() -> None:
    camera = Camera.looking_at(
        torch.tensor([0.3, 0.2, 0.9]), torch.tensor([0.0, 0.1, 0.0]), UP, width=640, height=480, focal_px=700.0
    )
    pixels, depth = camera.project(torch.tensor([[0.0, 0.1, 0.0], [0.0, 0.2, 0.0]], dtype=torch.float64))
    torch.testing.assert_close(pixels[0], torch.tensor([320.0, 240.0], dtype=torch.float64))
    assert pixels[1, 1] < pixels[0, 1], "v grows downwards"
    assert depth[0] == pytest.approx((0.09 + 0.01 + 0.81) ** 0.5)


def test_the_view_is_a_rotation_without_mirroring() -> None:
    camera = Camera.looking_at(torch.tensor([1.0, 2.0, 3.0]), torch.zeros(3), UP, width=2, height=2, focal_px=1.0)
    rotation = camera.camera_from_world[:3, :3]
    torch.testing.assert_close(rotation @ rotation.T, torch.eye(3, dtype=torch.float64))
    assert torch.linalg.det(rotation) == pytest.approx(1.0)


def test_a_scaled_camera_sees_the_same_view() -> None:
    camera = Camera(512, 334, 900.0, 905.0, 250.0, 170.0, torch.eye(4))
    point = torch.tensor([[0.01, -0.02, 0.6]], dtype=torch.float64)
    double, _ = camera.scaled(2.0).project(point)
    torch.testing.assert_close(double, 2 * camera.project(point)[0])
    odd = camera.scaled(0.3)
    relative = odd.project(point)[0] / torch.tensor([odd.width, odd.height])
    torch.testing.assert_close(relative, camera.project(point)[0] / torch.tensor([512, 334]))


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0},
        {"fx": float("nan")},
        {"fy": 0.0},
        {"fx": -3.0},
        {"cx": float("inf")},
        {"camera_from_world": torch.full((4, 4), float("nan"))},
        {"camera_from_world": torch.eye(3)},
    ],
)
def test_a_camera_that_cannot_see_is_refused(change: dict) -> None:
    good = {"width": 4, "height": 4, "fx": 5.0, "fy": 5.0, "cx": 2.0, "cy": 2.0, "camera_from_world": torch.eye(4)}
    with pytest.raises(InputError):
        Camera(**(good | change))


def test_a_view_along_up_is_refused() -> None:
    with pytest.raises(InputError, match="degenerate"):
        Camera.looking_at(torch.tensor([0.0, 1.0, 0.0]), torch.zeros(3), UP, width=4, height=4, focal_px=5.0)
