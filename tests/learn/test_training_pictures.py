"""Pictures to learn from: cut to the hand, made coarser, kept; every time with the camera that belongs to them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from lit_samples import known_light
from painted_samples import camera_at, discs, sample_of, write_rgba
from small_hands import joints_of

from jghand_engine.captures.sample import load_image
from jghand_engine.errors import InputError
from jghand_engine.learn import pictures as pictures_module
from jghand_engine.learn.pictures import CROP_MARGIN_PX, Pictures, View, coarser
from jghand_engine.native.tasks import SSIM_WINDOW_PX

SIZE = (120, 90)


def sample_with(tmp_path, mask: np.ndarray, *, focal_px: float = 200.0, name: str = "picture"):
    height, width = mask.shape
    picture = write_rgba(tmp_path / f"{name}.png", mask)
    return sample_of(picture, camera_at(size=(width, height), focal_px=focal_px), joints_of("relaxed"))


def boxed(rows: slice, columns: slice, size: tuple[int, int] = SIZE) -> np.ndarray:
    """A mask that is that box."""
    mask = np.zeros((size[1], size[0]), np.uint8)
    mask[rows, columns] = 255
    return mask


def corner_of(sample, view: View) -> tuple[int, int]:
    """Column and row of the whole picture at which the cut begins, from its camera."""
    return round(sample.camera.cx - view.camera.cx), round(sample.camera.cy - view.camera.cy)


# ---- cutting ---------------------------------------------------------------------------------------------------------


def test_a_picture_is_cut_to_the_hand_with_a_margin(tmp_path):
    sample = sample_with(tmp_path, boxed(slice(30, 61), slice(40, 81)))
    view = Pictures().view(sample)
    assert (view.camera.width, view.camera.height) == (41 + 2 * CROP_MARGIN_PX, 31 + 2 * CROP_MARGIN_PX)
    assert corner_of(sample, view) == (40 - CROP_MARGIN_PX, 30 - CROP_MARGIN_PX)
    assert tuple(view.rgb.shape) == (view.camera.height, view.camera.width, 3)
    assert tuple(view.mask.shape) == (view.camera.height, view.camera.width)


def test_a_picture_of_known_light_is_cut_like_any_other(tmp_path):
    mask, light = boxed(slice(30, 61), slice(40, 81)), replace(known_light(0), file=tmp_path / "picture.npz")
    groups, box_px = np.ones((light.groups, 31, 41, 3), np.float16), np.array([40, 30, 81, 61])
    np.savez(light.file, groups=groups, alpha=mask[30:61, 40:81], box_px=box_px, stamp=np.array("test"))
    sample = replace(sample_with(tmp_path, mask), light=light)
    plain, lit = (Pictures(known_light=known).view(sample) for known in (False, True))
    assert torch.equal(lit.mask, plain.mask)
    assert torch.equal(lit.rgb.amax(-1) > 0, lit.mask > 0)
    for name in ("width", "height", "fx", "fy", "cx", "cy"):
        assert getattr(lit.camera, name) == getattr(plain.camera, name), name


def test_a_cut_has_the_pixels_of_the_picture_on_black(tmp_path):
    sample = sample_with(tmp_path, boxed(slice(30, 61), slice(40, 81)))
    view, whole = Pictures().view(sample), load_image(sample)
    left, top = corner_of(sample, view)
    cut = slice(top, top + view.camera.height), slice(left, left + view.camera.width)
    # kept as bytes
    assert np.abs(view.rgb.numpy() - whole.rgb[cut]).max() <= 0.5 / 255 + 1e-6
    assert np.array_equal(view.mask.numpy(), whole.mask[cut])
    assert not view.rgb[view.mask == 0].any()
    # nothing of the hand is lost
    assert float(view.mask.sum()) == whole.mask.sum()


def test_the_hand_of_a_cut_is_where_its_camera_sees_the_joints(tmp_path):
    """Picture and camera are cut alike, whatever the place: every joint lies on the mask."""
    camera, joints_m = camera_at((0.2, 0.25, 0.5), size=SIZE, focal_px=150.0), joints_of("claw")
    sample = sample_of(write_rgba(tmp_path / "hand.png", discs(camera, joints_m, 2.0)), camera, joints_m)
    for stride in (1, 2):
        view = Pictures().view(sample, stride)
        pixels, _ = view.camera.project(joints_m)
        column, row = np.floor(pixels).astype(int).T
        assert bool((view.mask[row, column] > 0).all())
        # and the mask is nowhere else
        rows, columns = np.mgrid[: view.camera.height, : view.camera.width] + 0.5
        away = np.hypot(columns[..., None] - pixels[:, 0], rows[..., None] - pixels[:, 1]).min(-1)
        assert away[view.mask.numpy() > 0.5].max() < 2.0 / stride + 1.0


@pytest.mark.parametrize(
    ("row", "column"), [(0, 0), (0, 119), (89, 0), (89, 119), (0, 60), (45, 119)], ids=str
)  # fmt: skip
def test_a_tiny_hand_at_the_border_is_cut_inside_the_picture(tmp_path, row, column):
    """One pixel of it: still larger than the window of SSIM at stride 2, and the pixel is in it."""
    sample = sample_with(tmp_path, boxed(slice(row, row + 1), slice(column, column + 1)))
    view = Pictures().view(sample)
    left, top = corner_of(sample, view)
    assert 0 <= left <= column < left + view.camera.width <= SIZE[0]
    assert 0 <= top <= row < top + view.camera.height <= SIZE[1]
    assert min(view.camera.width, view.camera.height) >= 2 * SSIM_WINDOW_PX + 2
    assert float(view.mask.sum()) == 1
    assert float(view.mask[row - top, column - left]) == 1
    half = Pictures().view(sample, 2)
    assert min(half.rgb.shape[:2]) > SSIM_WINDOW_PX
    assert float(half.mask.sum()) == pytest.approx(0.25)


def test_a_picture_without_a_hand_is_refused_by_name(tmp_path):
    sample = sample_with(tmp_path, boxed(slice(0, 0), slice(0, 0)), name="nobody")
    with pytest.raises(InputError, match=r"nobody\.png.*empty mask"):
        Pictures().view(sample)


def test_a_half_transparent_edge_is_part_of_the_hand(tmp_path):
    mask = boxed(slice(40, 60), slice(50, 70))
    mask[39, 50:70] = 3
    view = Pictures().view(sample_with(tmp_path, mask))
    assert view.camera.height == 21 + 2 * CROP_MARGIN_PX
    assert float(view.mask[CROP_MARGIN_PX, CROP_MARGIN_PX]) == pytest.approx(3 / 255)


# ---- coarser ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stride", [2, 3])
def test_joints_of_a_coarser_view_lie_at_exactly_the_part(tmp_path, stride):
    view = Pictures().view(sample_with(tmp_path, boxed(slice(30, 61), slice(40, 81))))
    small = coarser(view, stride)
    joints_m = joints_of("relaxed")
    (full_px, full_m), (small_px, small_m) = (camera.project(joints_m) for camera in (view.camera, small.camera))
    np.testing.assert_allclose(stride * small_px, full_px, atol=1e-12, rtol=0)
    assert np.array_equal(small_m, full_m)


@pytest.mark.parametrize("stride", [2, 3])
def test_a_coarser_pixel_is_the_mean_of_those_it_covers(tmp_path, stride):
    view = Pictures().view(sample_with(tmp_path, boxed(slice(30, 61), slice(40, 81))))
    small = coarser(view, stride)
    height, width = view.camera.height // stride, view.camera.width // stride
    assert (small.camera.width, small.camera.height) == (width, height)
    assert tuple(small.rgb.shape) == (height, width, 3)
    blocks = view.rgb[: height * stride, : width * stride].reshape(height, stride, width, stride, 3)
    torch.testing.assert_close(small.rgb, blocks.mean((1, 3)))
    # what is left over is at the right and below, so that the first pixels stay the first
    assert view.camera.width % stride or view.camera.height % stride
    mask = view.mask[: height * stride, : width * stride].reshape(height, stride, width, stride)
    torch.testing.assert_close(small.mask, mask.mean((1, 3)))


# ---- keeping ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def loads(monkeypatch) -> list[str]:
    """Names of the pictures that were read, in order."""
    names: list[str] = []

    def load(sample):
        names.append(sample.image.stem)
        return load_image(sample)

    monkeypatch.setattr(pictures_module, "load_image", load)
    return names


def test_pictures_that_do_not_fit_are_read_again_the_longest_unused_first(tmp_path, loads, monkeypatch):
    samples = [sample_with(tmp_path, boxed(slice(30, 61), slice(40, 81)), name=name) for name in "abc"]
    one = 4 * (31 + 2 * CROP_MARGIN_PX) * (41 + 2 * CROP_MARGIN_PX)
    monkeypatch.setattr(pictures_module, "PICTURE_CACHE_BYTES", 2 * one)
    pictures = Pictures()
    for index in (0, 1, 0, 2, 0, 1):
        pictures.view(samples[index])
    # c took the place of b, which nobody had looked at for longest
    assert "".join(loads) == "abcb"
