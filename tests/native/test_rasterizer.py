"""The NumPy face of the kernel, which the frame uses without torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from splat_scenes import camera_for, hand_gaussians, in_precision, planes_of

from jghand_engine.errors import InputError
from jghand_engine.learn.reference import rasterize_reference
from jghand_engine.native import contract
from jghand_engine.native.library import load, runnable_variants
from jghand_engine.native.rasterizer import (
    SURFACE_MARGIN_PX,
    GaussianArrays,
    NativeRasterizer,
    SeenSurface,
    View,
)

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


def test_layers_are_drawn_as_colors_are_and_nothing_of_older_ones_stays():
    one, random_ = rasterizer(2), np.random.default_rng(3)
    cases = ((2000, 2, 120), (20, 2, 120), (2000, 1, 120), (2000, 0, 120), (20, 0, 120), (20, 2, 120), (20, 2, 70))
    for count, layers, width in cases:
        arrays, view = hand_arrays(count), view_for(width, 80)
        front = random_.choice(np.array([0, 0.3, 1], np.float32), count)
        arrays = replace(arrays, rgb=arrays.rgb * front[:, None], front=front)
        turned = np.concatenate([arrays.rgb[:, ::-1], 0.5 * arrays.rgb[:, :1]], 1)
        every = np.stack([turned, 2 * turned])[:layers] if layers else None
        planes = one.forward(replace(arrays, layers=every), view)
        assert np.array_equal(planes, rasterizer().forward(arrays, view))
        for layer in range(layers):
            drawn = one.layer_planes[layer] / (1 + layer)
            assert np.allclose(drawn[:3], planes[2::-1], atol=1e-6)
            assert np.allclose(drawn[3], 0.5 * planes[0], atol=1e-6)
    with pytest.raises(InputError, match="with `front`"):
        one.forward(replace(arrays, front=None, layers=every), view)


def test_planes_can_be_drawn_into_memory_of_the_caller():
    arrays, view = hand_arrays(300), view_for(40, 30)
    planes = np.full((5, 30, 40), np.nan, np.float32)
    assert rasterizer().forward(arrays, view, planes=planes) is planes
    assert np.array_equal(planes, rasterizer().forward(arrays, view))


def test_a_picture_in_the_rasterizers_own_memory_can_only_be_read():
    one, arrays, view = rasterizer(), hand_arrays(300), view_for(96, 64)
    planes = one.forward(arrays, view)
    with pytest.raises(ValueError, match="read-only"):
        planes[:] = 1  # tiles that stay empty would keep it
    assert np.array_equal(one.forward(arrays, view), rasterizer().forward(arrays, view))


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


def test_pixels_have_the_color_of_what_is_seen_of_them_from_outside():
    arrays, view = hand_arrays(2000), view_for(80, 50)
    front = np.random.default_rng(0).choice(np.array([0, 0.3, 1], np.float32), 2000)
    dimmed = replace(arrays, rgb=arrays.rgb * front[:, None], front=front)
    drawn = rasterizer().forward(dimmed, view).copy()
    plain = rasterizer().forward(replace(dimmed, front=None), view)
    hand = replace(
        hand_gaussians(2000, sigma_mm=(1, 2)), rgb=torch.from_numpy(dimmed.rgb), front=torch.from_numpy(front)
    )
    exact = rasterize_reference(in_precision(hand, torch.float64), camera_for(80, 50))
    difference = np.abs(drawn - planes_of(exact).numpy())
    # a contribution at the cut may fall on either side of it
    assert np.quantile(difference, 0.999) < 1e-5
    assert difference.max() < contract.ALPHA_MIN
    # outlines are sharper, and colors brighter, as what faces away is left out of their mean
    assert np.abs(drawn[3] - plain[3]).max() > 0.05
    assert np.abs(drawn[:3] - plain[:3]).max() > 0.1


def seen_surface(near: np.ndarray, part: float = 1.0) -> SeenSurface:
    """near: (H, W)"""
    return SeenSurface(np.pad(near.astype(np.float32), SURFACE_MARGIN_PX, constant_values=contract.NOT_NEAR), 1.0, part)


@pytest.mark.parametrize("orthographic", [False, True])
def test_gaussians_that_are_not_of_the_skin_that_a_pixel_shows_count_less(orthographic):
    """Of a surface with steps and holes, as the reference has it."""
    arrays, random_ = hand_arrays(2000), np.random.default_rng(1)
    front = np.ones(2000, np.float32)
    camera = (
        replace(camera_for(80, 50), fx=1500.0, fy=1400.0, orthographic=True) if orthographic else camera_for(80, 50)
    )
    view = replace(view_for(80, 50), fx=camera.fx, fy=camera.fy, orthographic=orthographic)
    hand = in_precision(replace(hand_gaussians(2000, sigma_mm=(1, 2)), front=torch.from_numpy(front)), torch.float64)
    depth_m = rasterize_reference(hand, camera).depth_m.numpy()
    shown_m = depth_m + np.repeat(random_.choice([-0.02, 0.0, 0.0, 0.01], (50, 8)), 10, 1)
    is_there = (depth_m > 0) & (random_.random((50, 80)) < 0.9)
    near = np.where(is_there, -shown_m if orthographic else 1 / np.where(is_there, shown_m, 1), contract.NOT_NEAR)
    one, surface = rasterizer(), seen_surface(near, part=0.8)
    every = one.forward(replace(arrays, front=front), view).copy()
    drawn = one.prepare(replace(arrays, front=front), view)
    one.set_surface(surface)
    one.run()
    assert one.finished()
    exact = planes_of(rasterize_reference(hand, camera, surface=surface)).numpy()
    difference = np.abs(drawn - exact)
    assert np.quantile(difference, 0.995) < 1e-5
    # one at the end of what is own may fall on either side of it
    assert (difference > 1e-3).mean() < 2e-3
    assert (np.abs(drawn - every) > 0.02).any(0).mean() > 0.05


def test_a_finger_before_another_does_not_blur_its_skin():
    position_m = np.array([[0, 0, 0.3], [0, 0, 0.31]], np.float32)
    rgb = np.array([[1, 0, 0], [0, 1, 0]], np.float32)
    fingers = GaussianArrays(position_m, np.full(2, 0.01, np.float32), np.full(2, 0.6, np.float32), rgb)
    fingers = replace(fingers, front=np.ones(2, np.float32))
    one, view = rasterizer(), View(5, 5, 300.0, 300.0, 2.5, 2.5, np.eye(3, 4))

    def red_part(skin_m: float) -> float:
        planes = one.prepare(fingers, view)
        one.set_surface(seen_surface(np.full((5, 5), 1 / skin_m)))
        one.run()
        assert one.finished()
        return planes[0, 2, 2] / planes[3, 2, 2]

    assert red_part(0.3) > 0.9
    assert red_part(0.31) < 0.2


def test_what_stands_beneath_a_thin_layer_gives_it_no_color():
    """In back light it is brighter by far; a layer that hides little shows what is behind it as ever."""

    def drawn(opacity: float) -> np.ndarray:
        position_m = np.array([[0, 0, 0.3], [0, 0, 0.301]], np.float32)
        rgb = np.array([[0.1, 0.1, 0.1], [3, 3, 3]], np.float32)
        layers = GaussianArrays(position_m, np.full(2, 0.01, np.float32), np.array([opacity, 0.99], np.float32), rgb)
        view = View(5, 5, 300.0, 300.0, 2.5, 2.5, np.eye(3, 4))
        return rasterizer().forward(replace(layers, front=np.ones(2, np.float32)), view)[0, 2, 2]

    assert drawn(0.9) == pytest.approx(0.1, rel=1e-2)
    assert drawn(0.5) == pytest.approx(0.5 * 0.1 + 0.5 * 0.99 * 3, rel=1e-2)
    # half way, where it is weighed by a half: 0.3 becomes 0.15
    assert drawn(0.7) == pytest.approx((0.7 * 0.1 + 0.15 * 0.99 * 3) / (0.7 + 0.15 * 0.99), rel=2e-2)


def test_what_is_covered_depends_on_nothing_beneath():
    """Nor does where a block of pixels stops show: beside it there is a hole, whose pixels go on."""
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-0.02, 0.02, 41)]))
    holed = np.hypot(x, y) > 0.006
    count, behind = holed.sum(), 3

    def drawn(sheets: int) -> np.ndarray:
        whole = np.concatenate([holed, np.ones((sheets - 1) * len(x), bool)])
        depth_m = np.repeat(0.3 + 0.02 * np.arange(sheets), len(x))
        position_m = np.stack([np.tile(x, sheets), np.tile(y, sheets), depth_m], 1).astype(np.float32)[whole]
        n = len(position_m)
        rgb = np.ones((n, 3), np.float32)
        rgb[count:] = 5
        sizes = np.full(n, 1e-3, np.float32), np.full(n, 0.95, np.float32)
        gaussians = GaussianArrays(position_m, *sizes, rgb, front=np.ones(n, np.float32))
        return rasterizer().forward(gaussians, View(41, 41, 300.0, 300.0, 20.5, 20.5, np.eye(3, 4))).copy()

    alone, before = drawn(1), drawn(1 + behind)
    covered = alone[3] == 1
    assert 0.8 < covered.mean() < 0.97
    assert np.array_equal(before[:, covered], alone[:, covered])
    assert before[0, 20, 20] > 3
    # what covers a pixel is as deep as what is seen of it
    assert np.allclose(alone[4, covered], 0.3, atol=1e-4)


def test_what_skin_hides_is_not_drawn():
    arrays, view = hand_arrays(2000), view_for(80, 50)
    front = np.random.default_rng(0).choice(np.array([-1, 0.3, 1], np.float32), 2000)
    arrays = replace(arrays, rgb=arrays.rgb * front.clip(0)[:, None])
    drawn = rasterizer().forward(replace(arrays, front=front), view).copy()
    kept = GaussianArrays(*(getattr(arrays, name)[front >= 0] for name in ("position_m", "sigma_m", "opacity", "rgb")))
    assert np.array_equal(drawn, rasterizer().forward(replace(kept, front=front[front >= 0]), view))
    hand = replace(
        hand_gaussians(2000, sigma_mm=(1, 2)), rgb=torch.from_numpy(arrays.rgb), front=torch.from_numpy(front)
    )
    exact = planes_of(rasterize_reference(in_precision(hand, torch.float64), camera_for(80, 50))).numpy()
    # a contribution at the cut may fall on either side of it
    assert np.quantile(np.abs(drawn - exact), 0.999) < 1e-5


def test_what_is_little_seen_from_outside_has_its_color_and_what_is_not_is_black():
    color, view = np.array([[0.8, 0.5, 0.4]], np.float32), View(5, 5, 300.0, 300.0, 2.5, 2.5, np.eye(3, 4))
    one = np.ones(1, np.float32)
    for front, drawn in ((0.05, color[0]), (0.0, np.zeros(3))):
        seen = GaussianArrays(np.array([[0, 0, 0.3]], np.float32), 0.01 * one, 0.99 * one, front * color)
        planes = rasterizer().forward(replace(seen, front=front * one), view)
        assert np.allclose(planes[:3, 2, 2] / planes[3, 2, 2], drawn, atol=1e-3)


def test_gradients_of_filled_gaps_are_refused():
    arrays, one = hand_arrays(20), rasterizer()
    planes = one.forward(replace(arrays, front=np.ones(20, np.float32)), view_for(8, 8))
    with pytest.raises(InputError, match="without `front`"):
        one.backward(np.ones_like(planes))


def test_through_a_gap_the_far_side_is_not_seen():
    x, y = (axis.ravel() for axis in np.meshgrid(*2 * [np.linspace(-0.02, 0.02, 41)]))
    gap = np.hypot(x, y) < 0.003
    count, whole = len(x), np.concatenate([~gap, np.ones(len(x), bool)])
    position_m = np.stack([np.tile(x, 2), np.tile(y, 2), np.repeat([0.3, 0.32], count)], 1).astype(np.float32)
    front = np.repeat(np.array([1, 0], np.float32), count)
    rgb = front[:, None] * np.array([0.8, 0.5, 0.4], np.float32)
    sheets = GaussianArrays(position_m, np.full(2 * count, 1e-3, np.float32), np.full(2 * count, 0.9, np.float32), rgb)
    sheets = GaussianArrays(*(getattr(sheets, name)[whole] for name in ("position_m", "sigma_m", "opacity", "rgb")))
    view = View(41, 41, 300.0, 300.0, 20.5, 20.5, np.eye(3, 4))
    middle = (slice(None), 20, 20)
    assert rasterizer().forward(sheets, view)[middle][0] < 0.3
    filled = rasterizer().forward(replace(sheets, front=front[whole]), view)[middle]
    assert np.abs(filled[:3] - np.array([0.8, 0.5, 0.4], np.float32)).max() < 1e-3


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
