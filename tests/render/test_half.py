"""Pictures drawn at half the size and enlarged: where every pixel stands, edges, depths, odd sizes, the receipt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from small_avatars import small_avatar

from jghand_engine.avatar.builtin import load_painted
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.poses import named_pose
from jghand_engine.native.enlarge import SAME_SURFACE_M, native_enlarged
from jghand_engine.native.library import load, runnable_variants
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings

CAMERA = Camera.looking_at([0.1, 0.1, 0.5], [0, 0.08, 0], [0, 1, 0], width=131, height=95, focal_px=260)  # type: ignore[arg-type]


# ---- the specification of the kernel ---------------------------------------------------------------------------------


def enlarged_color(rgba: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W, 4) float32 premultiplied of `Camera.halved` -> (height, width, 4), interpolated; beyond the edge it goes
    on."""
    return np.swapaxes(_doubled(np.swapaxes(_doubled(rgba, height), 0, 1), width), 0, 1)


def _doubled(values: np.ndarray, count: int) -> np.ndarray:
    """Twice as many rows, or one less: three quarters of the nearest and one of the next."""
    edged = np.concatenate([values[:1], values, values[-1:]])
    out = np.empty((2 * len(values), *values.shape[1:]), np.float32)
    for place, beside in ((0, edged[:-2]), (1, edged[2:])):
        out[place::2] = np.float32(0.75) * values + np.float32(0.25) * beside
    return out[:count]


def enlarged_depth(depth_m: np.ndarray, width: int, height: int) -> np.ndarray:
    """(H, W) float32 meters, 0 where there is nothing -> (height, width): the mean of those of the four nearest pixels
    that show the same surface as the nearest one does."""
    out = np.empty((height, width), np.float32)
    edged = np.pad(depth_m, 1, mode="edge")
    for down in (0, 1):
        for across in (0, 1):
            y, x = 2 * down - 1, 2 * across - 1
            total, weight = 9 * depth_m, np.full_like(depth_m, 9)
            for dy, dx, share in ((y, 0, 3), (0, x, 3), (y, x, 1)):
                other = edged[1 + dy : len(edged) - 1 + dy, 1 + dx : edged.shape[1] - 1 + dx]
                same = share * (np.abs(other - depth_m) < SAME_SURFACE_M)
                total += same * other
                weight += same
            place = out[down::2, across::2]
            place[...] = (total / weight)[: place.shape[0], : place.shape[1]]
    return out


@pytest.mark.parametrize("library", [load(name) for name in runnable_variants()], ids=lambda library: library.variant)
@pytest.mark.parametrize(("width", "height", "threads"), [(60, 100, 1), (61, 99, 2), (2, 3, 2), (1, 1, 1)])
def test_the_kernel_does_what_the_specification_says(library, width, height, threads):
    size = (height + 1) // 2, (width + 1) // 2
    generator = np.random.default_rng(width)
    rgba = generator.random((*size, 4), np.float32)
    depth_m = generator.choice(np.float32([0.5, 0.502, 0.53]), size)
    # a hole, empty rows above and below, and single pixels with nothing beside them
    drawn = generator.random(size) < 0.5
    drawn[: size[0] // 4], drawn[-(size[0] // 4) :] = False, False
    drawn[0, 0] = True
    rgba, depth_m = rgba * drawn[..., None], depth_m * drawn
    large, large_depth_m = native_enlarged(library, rgba, depth_m, (width, height), threads)
    assert np.allclose(large, enlarged_color(rgba, width, height), atol=1e-7)
    assert np.allclose(large_depth_m, enlarged_depth(depth_m, width, height), atol=1e-7)


def test_depths_of_finger_and_palm_are_kept_apart_and_nothing_stays_nothing():
    small = np.zeros((8, 9), np.float32)
    small[:, 3:6], small[:, 6:] = 0.50, 0.53
    large = enlarged_depth(small, 17, 16)
    assert np.unique(large).tolist() == pytest.approx([0.0, 0.50, 0.53])
    assert (large[:, :6] == 0).all()


def test_depths_of_one_surface_are_interpolated():
    small = (0.5 + 0.001 * np.arange(10, dtype=np.float32))[None].repeat(6, 0)
    large = enlarged_depth(small, 20, 12)
    assert np.allclose(np.diff(large[:, 1:-1], axis=1), 0.0005, atol=1e-6)


def test_half_the_camera_sees_the_same_picture():
    camera = CAMERA.halved()
    assert (camera.width, camera.height) == (66, 48)
    points = np.array([[0.0, 0.08, 0.0], [0.02, 0.05, 0.01]])
    assert np.allclose(2 * camera.project(points)[0], CAMERA.project(points)[0])


def test_a_frame_of_half_the_size_resembles_the_whole_one_and_says_so():
    avatar = load_painted(handedness=Handedness.RIGHT).prefix(4000)
    joints_m = named_pose("relaxed", avatar.canonical_joints_m, handedness=avatar.handedness)
    camera = replace(CAMERA, width=263, height=191, fx=480, fy=480, cx=131.5, cy=95.5)
    whole = HandRenderer(avatar, RenderSettings()).render(joints_m, camera)
    frame = HandRenderer(avatar, RenderSettings(half=True)).render(joints_m, camera)
    assert frame.rgba.shape == whole.rgba.shape
    assert frame.depth_m.shape == whole.depth_m.shape
    assert frame.report.total_ms >= frame.report.stages["enlarge"]
    error = np.abs(frame.rgba - whole.rgba).mean()
    moved = [np.abs(np.roll(frame.rgba, by, axis) - whole.rgba).mean() for by in (-1, 1) for axis in (0, 1)]
    # 0.0053, and 0.0068 or more a pixel off
    assert error < 0.85 * min(moved)
    assert error < 0.0055
    both = (frame.depth_m > 0) & (whole.depth_m > 0)
    assert both.mean() > 0.1
    assert np.median(np.abs(frame.depth_m - whole.depth_m)[both]) < 0.0005


def test_without_depth_none_is_made():
    avatar = small_avatar(50)
    frame = HandRenderer(avatar, RenderSettings(half=True, depth=False)).render(avatar.canonical_joints_m, CAMERA)
    assert not frame.depth_m.any()
