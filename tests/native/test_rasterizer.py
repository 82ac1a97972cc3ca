"""The NumPy face of the kernel, which the frame uses without torch."""

from __future__ import annotations

import numpy as np
import pytest
from splat_scenes import camera_for, hand_gaussians

from jghand_engine.errors import InputError
from jghand_engine.native import contract
from jghand_engine.native.library import load, runnable_variants
from jghand_engine.native.rasterizer import GaussianArrays, NativeRasterizer, View

pytestmark = pytest.mark.skipif(not runnable_variants(), reason="no native library runs here")


def hand_arrays(count: int) -> GaussianArrays:
    hand = hand_gaussians(count, sigma_mm=(1, 2))
    return GaussianArrays(*(getattr(hand, name).numpy() for name in ("position_m", "sigma_m", "opacity", "rgb")))


def view_for(width: int, height: int) -> View:
    camera = camera_for(width, height)
    matrix = camera.camera_from_world[:3]
    return View(width, height, camera.fx, camera.fy, camera.cx, camera.cy, matrix)


def rasterizer(threads: int = 1) -> NativeRasterizer:
    library = load(runnable_variants()[0])
    assert library is not None
    return NativeRasterizer(library, threads)


def test_camera_frame_positions_draw_the_same_picture():
    arrays, view = hand_arrays(1000), view_for(80, 50)
    matrix = view.camera_from_position
    in_camera = (arrays.position_m.astype(np.float64) @ matrix[:, :3].T + matrix[:, 3]).astype(np.float32)
    there = View(80, 50, view.fx, view.fy, view.cx, view.cy, np.eye(3, 4))
    want = rasterizer().forward(arrays, view).copy()
    got = rasterizer().forward(GaussianArrays(in_camera, arrays.sigma_m, arrays.opacity, arrays.rgb), there)
    assert np.array_equal(got, want)  # the kernel rounds to the same float32 positions


def test_a_root_given_in_float64_loses_nothing_however_far_it_is():
    arrays, view = hand_arrays(1000), view_for(80, 50)
    root = np.array([12345.678901, -98765.4321, 555.5])
    far = view.camera_from_position.copy()
    far[:, 3] -= far[:, :3] @ root  # the camera moves with the root
    with_root = far.copy()
    with_root[:, 3] += with_root[:, :3] @ root  # and positions are given relative to it
    there = View(80, 50, view.fx, view.fy, view.cx, view.cy, with_root)
    difference = np.abs(rasterizer().forward(arrays, there).copy() - rasterizer().forward(arrays, view))
    assert difference.max() <= 1e-4  # observed 1.1e-5: float64 rounding of the root, seen through the cut


def test_one_rasterizer_draws_pictures_of_any_size_one_after_the_other():
    one = rasterizer(2)
    for count, size in ((500, (64, 48)), (20, (200, 10)), (0, (3, 3)), (3000, (64, 48))):
        arrays, view = hand_arrays(count), view_for(*size)
        assert np.array_equal(one.forward(arrays, view), rasterizer().forward(arrays, view))
        assert one.visible <= count


def test_planes_can_be_drawn_into_memory_of_the_caller():
    arrays, view = hand_arrays(300), view_for(40, 30)
    planes = np.full((5, 30, 40), np.nan, np.float32)
    assert rasterizer().forward(arrays, view, planes=planes) is planes
    assert np.array_equal(planes, rasterizer().forward(arrays, view))


@pytest.mark.parametrize("between", [False, True])
def test_tiles_that_become_empty_are_cleared(between: bool):
    arrays, one = hand_arrays(300), rasterizer()
    here, moved = view_for(96, 64), view_for(96, 64).camera_from_position.copy()
    moved[0, 3] += 0.25  # most of the hand leaves the picture
    away = View(96, 64, here.fx, here.fy, here.cx, here.cy, moved)
    for view in (here, away, here, away):
        if between:  # what is drawn elsewhere says nothing about this object's own memory
            one.forward(arrays, away, planes=np.empty((5, 64, 96), np.float32))
        assert np.array_equal(one.forward(arrays, view), rasterizer().forward(arrays, view))


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("sigma_m", np.zeros(10), "float32"),
        ("opacity", np.zeros(9, np.float32), r"\(10,\)"),
        ("rgb", np.zeros((10, 6), np.float32)[:, ::2], "contiguous"),
        ("position_m", [[0.0, 0.0, 0.0]] * 10, "float32"),
        ("position_m", np.frombuffer(bytes(121), np.uint8)[1:].view(np.float32).reshape(10, 3), "aligned"),
    ],
)
def test_arrays_the_kernel_cannot_read_are_refused_by_name(name, value, wanted):
    arrays = hand_arrays(10)
    parts = {key: getattr(arrays, key) for key in ("position_m", "sigma_m", "opacity", "rgb")} | {name: value}
    with pytest.raises(InputError, match=f"{name}.*{wanted}"):
        rasterizer().forward(GaussianArrays(**parts), view_for(8, 8))


def test_memory_that_may_only_be_read_is_refused_for_results():
    planes = np.zeros((5, 30, 40), np.float32)
    planes.flags.writeable = False
    with pytest.raises(InputError, match=r"planes.*written.*read-only"):
        rasterizer().forward(hand_arrays(10), view_for(40, 30), planes=planes)


def test_a_picture_too_large_is_refused():
    with pytest.raises(InputError, match="image size"):
        rasterizer().forward(hand_arrays(1), View(contract.IMAGE_MAX_PX + 1, 1, 1.0, 1.0, 0, 0, np.eye(3, 4)))


def test_backward_before_forward_is_refused():
    with pytest.raises(InputError, match="forward"):
        rasterizer().backward(np.zeros((5, 8, 8), np.float32))


def test_a_picture_that_was_refused_has_no_backward_pass():
    arrays, view = hand_arrays(50), view_for(20, 12)
    one, gradient = rasterizer(), np.ones((5, 12, 20), np.float32)
    one.forward(arrays, view)
    want = one.backward(gradient)
    with pytest.raises(InputError, match="image size"):
        one.forward(hand_arrays(90), view_for(contract.IMAGE_MAX_PX + 1, 1))
    with pytest.raises(InputError, match="forward"):
        one.backward(gradient)
    one.forward(arrays, view)
    assert np.array_equal(one.backward(gradient).position_m, want.position_m)
