"""The figures that are reported: against known values, and the regions they are taken on."""

import math

import numpy as np
import pytest
import torch
from test_losses import plain_factors

from jghand_engine.errors import InputError
from jghand_engine.learn import metrics


def scene(height=200, width=180, seed=0):
    """A smooth random picture inside an elliptic mask over black."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[0:height, 0:width]
    mask = (((y - 95) / 60) ** 2 + ((x - 80) / 50) ** 2 <= 1).astype(np.float32)
    waves = [0.5 + 0.3 * np.sin(0.1 * (1 + c) * x + 0.07 * y + random.uniform(0, 6)) for c in range(3)]
    return np.stack(waves, -1).astype(np.float32) * mask[..., None], mask


def noisy(picture, sigma, seed=1):
    return np.clip(picture + sigma * np.random.default_rng(seed).standard_normal(picture.shape), 0, 1)


def test_equal_pictures_score_perfectly_and_finitely():
    picture, mask = scene()
    scores = metrics.compare(picture, picture, mask)
    assert scores["psnr_full"] == scores["psnr_box"] == scores["psnr_mask"] == 100
    assert scores["ssim_box"] == pytest.approx(1, abs=1e-6)
    assert scores["ms_ssim_box"] == pytest.approx(1, abs=1e-6)
    assert all(math.isfinite(value) for value in scores.values())


@pytest.mark.parametrize(("row", "column"), [(0, 0), (50, 40), (99, 79)])
def test_the_box_of_a_speck_is_still_wide_enough_to_measure(row, column):
    mask = np.zeros((100, 80), np.float32)
    mask[row, column] = 1
    box = metrics.mask_box(mask)
    assert box.of(mask).shape == (32, 32)
    assert box.of(mask).sum() == 1


def test_an_empty_mask_is_refused():
    with pytest.raises(InputError, match="pixels of a hand"):
        metrics.mask_box(np.full((20, 20), 0.4))


def test_each_region_sees_its_own_pixels():
    picture, mask = scene()
    outside_box, in_box_only = picture.copy(), picture.copy()
    outside_box[5, 5] = 1
    in_box_only[36, 31] = 1
    assert mask[36, 31] == 0
    scores = metrics.compare(outside_box, picture, mask)
    assert scores["psnr_full"] < 100
    assert scores["psnr_box"] == scores["psnr_mask"] == 100
    scores = metrics.compare(in_box_only, picture, mask)
    assert scores["psnr_box"] < scores["psnr_full"] < 100
    assert scores["psnr_mask"] == 100


def test_every_metric_falls_with_noise():
    picture, mask = scene()
    scores = [metrics.compare(noisy(picture, sigma), picture, mask) for sigma in (0.02, 0.05, 0.1)]
    for name in ("psnr_full", "psnr_box", "psnr_mask", "ssim_full", "ssim_box", "ms_ssim_full", "ms_ssim_box"):
        values = [one[name] for one in scores]
        assert values == sorted(values, reverse=True), name


def test_ms_ssim_is_the_published_product_of_scales():
    a, b = scene(256, 224)[0], noisy(scene(256, 224)[0], 0.1)
    product, ours, theirs = 1.0, torch.from_numpy(a).double(), torch.from_numpy(b)
    for number, weight in enumerate((0.0448, 0.2856, 0.3001, 0.2363, 0.1333)):
        luminance, contrast = plain_factors(ours, theirs)
        value = (luminance * contrast if number == 4 else contrast).mean((1, 2))
        product *= value**weight
        ours, theirs = (p.reshape(p.shape[0] // 2, 2, p.shape[1] // 2, 2, 3).mean((1, 3)) for p in (ours, theirs))
    # single against double precision: worst observed 1e-6
    assert metrics.ms_ssim(a, b.astype(np.float32)) == pytest.approx(float(product.mean()), abs=1e-5)


def test_ms_ssim_of_a_small_picture_keeps_its_five_scales():
    a, b = scene()[0][40:100, 40:100], noisy(scene()[0], 0.1)[40:100, 40:100]
    framed_a, framed_b = (np.pad(p, ((58, 58), (58, 58), (0, 0))) for p in (a, b))
    assert metrics.ms_ssim(a, b) == pytest.approx(metrics.ms_ssim(framed_a, framed_b), abs=1e-6)


def test_flip_is_zero_on_equal_pictures_and_grows_with_noise():
    if metrics.flip_package() is None:
        pytest.skip(metrics.FLIP_MISSING)
    picture, mask = scene()
    values = [metrics.compare(noisy(picture, sigma), picture, mask)["flip_box"] for sigma in (0, 0.02, 0.1)]
    assert values[0] == 0
    assert values == sorted(values)


def test_pictures_that_cannot_be_compared_are_refused():
    picture, mask = scene()
    with pytest.raises(InputError, match="shape"):
        metrics.compare(picture[1:], picture, mask)
    broken = picture.copy()
    broken[3, 3, 1] = np.nan
    with pytest.raises(InputError, match="finite"):
        metrics.compare(broken, picture, mask)
