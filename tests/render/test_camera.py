"""The pinhole camera."""

import math
from dataclasses import replace

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.native.contract import Z_NEAR_M
from jghand_engine.render.camera import PARALLEL_EYE_M, Camera, Lens

UP = np.array([0.0, 1.0, 0.0])
EYE_M, TARGET_M = np.array([0.3, 0.2, 0.9]), np.array([0.0, 0.1, 0.0])


def oblong() -> Camera:
    """No two of its numbers are equal."""
    view = Camera.looking_at(EYE_M, TARGET_M, UP, width=64, height=48, focal_px=70.0).camera_from_world
    return Camera(64, 48, 70.0, 90.0, 20.0, 31.0, view)


def points_m(count: int) -> np.ndarray:
    return 0.1 * np.random.default_rng(0).standard_normal((count, 3))


def test_the_target_lands_in_the_middle_and_up_is_up() -> None:
    camera = Camera.looking_at(
        np.array([0.3, 0.2, 0.9]), np.array([0.0, 0.1, 0.0]), UP, width=640, height=480, focal_px=700.0
    )
    pixels, depth = camera.project(np.array([[0.0, 0.1, 0.0], [0.0, 0.2, 0.0]]))
    np.testing.assert_allclose(pixels[0], np.array([320.0, 240.0]))
    assert pixels[1, 1] < pixels[0, 1], "v grows downwards"
    assert depth[0] == pytest.approx((0.09 + 0.01 + 0.81) ** 0.5)


def test_the_view_is_a_rotation_without_mirroring() -> None:
    camera = Camera.looking_at(np.array([1.0, 2.0, 3.0]), np.zeros(3), UP, width=2, height=2, focal_px=1.0)
    rotation = camera.camera_from_world[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-15)
    assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_scaled_camera_sees_the_same_view() -> None:
    camera = Camera(512, 334, 900.0, 905.0, 250.0, 170.0, np.eye(4))
    point = np.array([[0.01, -0.02, 0.6]])
    double, _ = camera.scaled(2.0).project(point)
    np.testing.assert_allclose(double, 2 * camera.project(point)[0])
    odd = camera.scaled(0.3)
    relative = odd.project(point)[0] / np.array([odd.width, odd.height])
    np.testing.assert_allclose(relative, camera.project(point)[0] / np.array([512, 334]))


def test_points_are_projected_by_the_matrix_of_the_pinhole() -> None:
    """K [R | t] in homogeneous coordinates."""
    view, points = oblong(), points_m(20)
    intrinsic = np.array([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]])
    homogeneous = np.concatenate([points, np.ones((20, 1))], 1)
    pixels = homogeneous @ view.camera_from_world[:3].T @ intrinsic.T
    got, depth = view.project(points)
    np.testing.assert_allclose(got, pixels[:, :2] / pixels[:, 2:], rtol=1e-13)
    np.testing.assert_allclose(depth, pixels[:, 2], rtol=1e-13)
    assert view.project(points.reshape(4, 5, 3))[0].shape == (4, 5, 2)


@pytest.mark.filterwarnings("error")
def test_a_point_in_the_plane_of_the_camera_is_nowhere_and_the_others_stay() -> None:
    view, others = replace(oblong(), camera_from_world=np.eye(4)), points_m(3) + np.array([0, 0, 1])
    pixels, depth = view.project(np.concatenate([[[0.1, 0, 0]], others]))
    assert (pixels[0, 0], depth[0]) == (math.inf, 0)
    np.testing.assert_array_equal(pixels[1:], view.project(others)[0])


def test_the_eye_is_where_it_was_put() -> None:
    np.testing.assert_allclose(oblong().eye_m, EYE_M)


def test_parallel_rays_draw_a_meter_equally_large_at_every_depth() -> None:
    view, points = replace(oblong(), orthographic=True), points_m(20)
    inside = points @ view.camera_from_world[:3, :3].T + view.camera_from_world[:3, 3]
    pixels, depth = view.project(points)
    size, middle = np.array([70.0, 90.0]), np.array([20.0, 31.0])
    np.testing.assert_allclose(pixels, inside[:, :2] * size + middle, rtol=1e-13, atol=0)
    np.testing.assert_allclose(depth, inside[:, 2])
    # they come from far behind
    behind = np.linalg.inv(view.camera_from_world) @ np.array([0, 0, -PARALLEL_EYE_M, 1])
    np.testing.assert_allclose(view.eye_m, behind[:3])
    with pytest.raises(InputError, match="orthographic camera: wanted no lens"):
        replace(view, lens=Lens(0.01, 0.5))


def test_a_meter_is_as_many_pixels_as_along_the_longer_axis() -> None:
    for view in (oblong(), replace(oblong(), fx=90.0, fy=70.0)):
        assert view.px_per_meter(0.3) == pytest.approx(300.0)
        assert replace(view, orthographic=True).px_per_meter(0.3) == 90.0


def test_a_part_of_the_picture_sees_its_points_where_the_whole_does() -> None:
    view, points = oblong(), points_m(20)
    part = view.part(5, 11, 30, 20)
    assert (part.width, part.height) == (30, 20)
    np.testing.assert_allclose(part.project(points)[0], view.project(points)[0] - np.array([5.0, 11.0]))


def test_through_a_place_of_the_lens_the_focus_stays_and_the_rest_moves() -> None:
    """By similar triangles: a place of the lens moves a point by f * place * (1 / focus - 1 / depth)."""
    pinhole, place_m = oblong(), (0.004, -0.007)
    view = Camera(64, 48, 70.0, 90.0, 20.0, 31.0, pinhole.camera_from_world, Lens(aperture_m=0.02, focus_m=0.8))
    points = points_m(20)
    there = view.through(*place_m)
    assert there.lens is None
    pixels, depth = pinhole.project(points)
    away = np.array([70 * place_m[0], 90 * place_m[1]]) * (1 / 0.8 - 1 / depth)[:, None]
    np.testing.assert_allclose(there.project(points)[0], pixels + away, rtol=1e-12, atol=1e-12)
    assert pinhole.through(*place_m) is pinhole


def test_a_point_becomes_a_disc_as_wide_as_the_pinholes_of_the_lens_spread_it() -> None:
    lens = Lens(aperture_m=0.02, focus_m=0.8)
    for depth_m in (0.3, 0.8, 2.5):
        wide = 50.0 * 0.02 * abs(1 / 0.8 - 1 / depth_m)
        assert lens.blur_px(50.0, depth_m) == pytest.approx(wide, abs=1e-14)


def test_the_ends_of_what_a_lens_may_be() -> None:
    assert Lens(0.0, math.nextafter(Z_NEAR_M, 1)).blur_px(50.0, 1.0) == 0
    for aperture_m, focus_m, name in (
        (-1e-9, 0.5, "aperture_m"),
        (math.inf, 0.5, "aperture_m"),
        (math.nan, 0.5, "aperture_m"),
        (0.01, Z_NEAR_M, "focus_m"),
        (0.01, -1.0, "focus_m"),
        (0.01, math.inf, "focus_m"),
    ):
        with pytest.raises(InputError, match=f"lens: {name}"):
            Lens(aperture_m, focus_m)


@pytest.mark.parametrize(
    "change",
    [
        {"width": 0},
        {"height": 0},
        {"cy": float("nan")},
        {"fy": float("inf")},
        {"camera_from_world": np.eye(4) + np.diag(np.array([0.0, math.inf, 0.0]), 1)},
        {"fx": float("nan")},
        {"fy": 0.0},
        {"fx": -3.0},
        {"cx": float("inf")},
        {"camera_from_world": np.full((4, 4), float("nan"))},
        {"camera_from_world": np.eye(3)},
    ],
)
def test_a_camera_that_cannot_see_is_refused(change: dict) -> None:
    good = {"width": 4, "height": 4, "fx": 5.0, "fy": 5.0, "cx": 2.0, "cy": 2.0, "camera_from_world": np.eye(4)}
    with pytest.raises(InputError):
        Camera(**(good | change))


def test_a_view_along_up_is_refused() -> None:
    with pytest.raises(InputError, match="degenerate"):
        Camera.looking_at(np.array([0.0, 1.0, 0.0]), np.zeros(3), UP, width=4, height=4, focal_px=5.0)
