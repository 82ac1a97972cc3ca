"""Pictures and masks as training sees them: the hand on black, and broken files named."""

import dataclasses

import numpy as np
import pytest
from picture_sets import look, pose
from PIL import Image

from jghand_engine.captures.image_files import probe_image, probe_sized, read_image, read_mask
from jghand_engine.captures.masks import template_mask
from jghand_engine.captures.sample import MaskSource, Sample, load_image, pixel_at_hand_m
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness

WIDTH, HEIGHT = 40, 30


@pytest.fixture
def sample(tmp_path):
    """A sample whose picture is not yet there."""
    view = dataclasses.replace(look(0.0, 334, 512).scaled(0.1), width=WIDTH, height=HEIGHT)
    return Sample(tmp_path / "picture.png", view, np.array(pose(0)), Handedness.RIGHT, "Capture0", "ROM", 0, "400262")


def save(path, *channels, mode=None, **options):
    """A picture with each channel of one value, or given whole."""
    planes = [np.broadcast_to(np.asarray(channel, np.uint8), (HEIGHT, WIDTH)) for channel in channels]
    image = Image.fromarray(planes[0] if len(planes) == 1 else np.stack(planes, -1))
    (image.convert(mode) if mode else image).save(path, **options)
    return path


def test_a_pixel_at_the_hand_is_that_of_whole_views_beside_close_ups_on_a_hand_of_canonical_size(sample):
    near, joints_m = 0.5 * sample.joints_m, sample.joints_m
    images = [sample, sample, sample, dataclasses.replace(sample, camera=sample.camera.scaled(10.0))]
    size_m = np.linalg.norm(sample.camera.eye_m - joints_m.mean(0)) / sample.camera.fx
    assert pixel_at_hand_m(images[:3], joints_m) == pytest.approx(size_m)
    assert pixel_at_hand_m(images[:3], near) == pytest.approx(0.5 * size_m)
    # a quarter of them: of any of these, and not of one in between
    assert pixel_at_hand_m(images, joints_m) == pytest.approx(size_m)
    assert pixel_at_hand_m([*images, *images[2:]], joints_m) == pytest.approx(size_m)


def test_straight_alpha_becomes_the_hand_on_black(sample):
    alpha = np.linspace(0, 255, WIDTH).round().astype(np.uint8)
    save(sample.image, 255, 102, 0, alpha)
    picture = load_image(sample)
    assert picture.rgb.dtype == picture.mask.dtype == np.float32
    np.testing.assert_allclose(picture.mask[7], alpha / 255, atol=1e-7)
    np.testing.assert_allclose(picture.rgb[7], (alpha / 255)[:, None] * [1.0, 0.4, 0.0], atol=1e-7)


def test_what_is_under_full_transparency_does_not_count(sample):
    save(sample.image, 255, 255, 255, 0)
    assert not load_image(sample).rgb.any()


def test_a_mask_file_counts_from_half_gray_on(sample, tmp_path):
    save(sample.image, 200, 100, 50)
    gray = np.zeros(WIDTH, np.uint8)
    gray[:4] = (127, 128, 255, 60)
    mask = save(tmp_path / "mask.png", gray)
    picture = load_image(dataclasses.replace(sample, mask_source=MaskSource.FILE, mask=mask))
    assert picture.mask[3, :5].tolist() == [0, 1, 1, 0, 0]
    assert picture.rgb[3, 2] * 255 == pytest.approx([200, 100, 50])
    assert not picture.rgb[3, 3].any()


@pytest.mark.parametrize("mode", ["L", "RGB", "RGBA", "1", "P", "LA"])
def test_masks_are_read_in_any_kind_of_picture(tmp_path, mode):
    columns = np.where(np.arange(WIDTH) < 10, 255, 0).astype(np.uint8)
    if "A" in mode:
        # the alpha is the mask, the color is not
        file = save(tmp_path / "mask.png", 9, 9, 9, columns, mode=mode)
    else:
        file = save(tmp_path / "mask.png", columns, mode=mode)
    mask = read_mask(file)
    assert mask[:, :10].all()
    assert not mask[:, 10:].any()


def test_a_jpeg_mask_is_cut_where_it_was(tmp_path):
    columns = np.where(np.arange(WIDTH) < 16, 255, 0).astype(np.uint8)
    mask = read_mask(save(tmp_path / "mask.jpg", columns, quality=60))
    assert set(np.unique(mask)) == {0.0, 1.0}
    assert mask.sum() == 16 * HEIGHT


def test_a_picture_without_alpha_has_no_mask_of_its_own(sample):
    save(sample.image, 200, 100, 50)
    with pytest.raises(InputError, match="an alpha channel"):
        load_image(sample)
    projected = load_image(dataclasses.replace(sample, mask_source=MaskSource.TEMPLATE)).mask
    np.testing.assert_array_equal(projected, template_mask(sample.camera, sample.joints_m, sample.handedness))


@pytest.mark.parametrize("what", ["picture", "mask"])
def test_a_picture_or_mask_of_another_size_than_the_camera_is_refused(sample, tmp_path, what):
    save(sample.image, 1, 2, 3)
    mask = save(tmp_path / "mask.png", 255)
    other = sample.image if what == "picture" else mask
    Image.open(other).resize((WIDTH // 2, HEIGHT)).save(other)
    with pytest.raises(InputError, match=rf"size of .*{other.name}: wanted 40 x 30 .*got 20 x 30"):
        load_image(dataclasses.replace(sample, mask_source=MaskSource.FILE, mask=mask))


def test_a_mask_that_should_be_a_file_and_is_none_is_named(sample):
    save(sample.image, 1, 2, 3)
    with pytest.raises(InputError, match="wanted a mask file, got none named"):
        load_image(dataclasses.replace(sample, mask_source=MaskSource.FILE))


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_the_head_of_a_picture_tells_its_size_and_its_end_whether_it_is_whole(tmp_path, suffix):
    # noise: the end is then far from the head
    noise = np.random.default_rng(0).integers(0, 255, (3, HEIGHT, WIDTH))
    file = save(tmp_path / f"picture{suffix}", *noise)
    facts = probe_image(file)
    assert (facts.width, facts.height, facts.has_alpha) == (WIDTH, HEIGHT, False)
    whole = file.read_bytes()
    # some cameras pad the file
    file.write_bytes(whole + bytes(10))
    assert probe_image(file) == facts
    file.write_bytes(whole[: len(whole) * 9 // 10])
    with pytest.raises(InputError, match=rf"{file.name}: got .*Get that file again"):
        probe_image(file)
    with pytest.raises(InputError, match="40 x 31 pixels, as the camera says"):
        file.write_bytes(whole)
        probe_sized(file, (40, 31), "the camera")


def test_transparency_of_a_palette_is_alpha(tmp_path):
    image = Image.fromarray(np.zeros((HEIGHT, WIDTH), np.uint8), "P")
    image.putpalette([255, 0, 0] * 256)
    image.save(tmp_path / "p.png", transparency=0)
    assert probe_image(tmp_path / "p.png").has_alpha
    assert read_image(tmp_path / "p.png")[0, 0].tolist() == [255, 0, 0, 0]
