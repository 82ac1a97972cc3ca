"""Where cameras stand, and what they frame."""

import numpy as np
import pytest

from jghand_engine.captures.making.cameras import plan_cameras, sphere_directions
from jghand_engine.captures.making.options import CaptureOptions
from jghand_engine.captures.making.rig import RiggedHand, load_identity
from jghand_engine.errors import InputError
from jghand_engine.render.camera import Camera


@pytest.fixture(scope="module")
def posed() -> np.ndarray:
    hand = RiggedHand(load_identity("big_man"))
    return hand.skin(hand.pose(np.stack([hand.angles_of(name) for name in ("open", "fist", "spread")])))


def whole_views(
    posed: np.ndarray, count: int = 12, size_px: tuple[int, int] = (334, 512), seed: int = 0
) -> list[Camera]:
    planned = plan_cameras(count, size_px, seed, posed)
    assert {(one.pose, one.samples) for one in planned} == {(None, None)}
    return [one.camera for one in planned]


def test_every_pose_is_wholly_in_the_picture_and_fills_one_direction(posed):
    assert len(whole_views(posed)) == 12
    for camera in whole_views(posed):
        px, depth = camera.project(posed.reshape(-1, 3))
        assert depth.min() > 0.5
        part = np.concatenate([px.min(0), px.max(0)]) / [334, 512, 334, 512]
        # the margin is 3 %
        assert part.min() > 0.0299
        assert part.max() < 0.9701
        assert (np.ptp(px, axis=0) / [334, 512]).max() == pytest.approx(0.94)


def test_cameras_stand_all_around_above_and_below(posed):
    away = np.stack([camera.eye_m for camera in whole_views(posed)]) - posed.reshape(-1, 3).mean(0)
    directions = away / np.linalg.norm(away, axis=1, keepdims=True)
    for axis in np.concatenate([np.eye(3), -np.eye(3)]):
        assert (directions @ axis).max() > 0.7


def test_principal_points_are_off_the_center_and_pixels_square(posed):
    cameras = whole_views(posed)
    assert max(abs(camera.cx - 167) for camera in cameras) > 5
    assert all(camera.fx == camera.fy for camera in cameras)


def test_the_seed_decides_the_cameras(posed):
    first, again, other = (whole_views(posed, 5, (64, 96), seed) for seed in (0, 0, 1))
    assert [c.camera_from_world.tolist() for c in first] == [c.camera_from_world.tolist() for c in again]
    assert first[0].camera_from_world.tolist() != other[0].camera_from_world.tolist()


@pytest.mark.parametrize("count", [1, 2, 5, 40])
def test_directions_are_unit_vectors_and_apart(count):
    directions = sphere_directions(count, 0.3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-12)
    if count > 1:
        cosine = directions @ directions.T - 2 * np.eye(count)
        # a sphere shared out evenly leaves each about 3.5 / sqrt(n) radians
        assert np.arccos(cosine.max().clip(-1, 1)) > 1.7 / count**0.5


@pytest.mark.parametrize(
    ("numbers", "named"),
    [
        ((0, 0, 25, 334, 512), "cameras"),
        ((4, 4, 25, 334, 512), "close-ups"),
        ((4, -1, 25, 334, 512), "close-ups"),
        ((4, 1, 25, 3, 512), "image"),
        ((4, 1, 25, 334, 99999), "image"),
    ],
)
def test_what_cannot_be_is_refused_by_name(numbers, named):
    with pytest.raises(InputError, match=named):
        CaptureOptions("3", *numbers).check()
