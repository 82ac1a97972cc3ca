"""Crops: where they lie, and what the power of their detail catches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from jghand_engine.captures.sample import TrainingImage
from jghand_engine.learn import crops, tables
from jghand_engine.learn.evaluate import Evaluation, PictureScore


def skin(size, seed=0):
    """Detail of every wavelength, about a color of skin; (size, size, 3) float32."""
    random = np.random.default_rng(seed)
    layers = [sigma * ndimage.gaussian_filter(random.normal(size=(size, size)), sigma) for sigma in (0.6, 1.2, 2.5, 5)]
    gray = np.sum(layers, axis=0)
    return np.clip(np.array([0.7, 0.5, 0.4]) + 0.04 * gray[..., None], 0, 1).astype(np.float32)


def at_scale(sample, mm_px):
    """`sample` by a camera whose pixels show so much of the hand, all of which it shows."""
    return replace(sample, camera=sample.camera.scaled(crops.millimeters_per_pixel(sample) / mm_px))


def picture(mask, seed=0):
    return TrainingImage(skin(len(mask), seed) * mask[..., None], mask)


@pytest.fixture(scope="module")
def sample(capture):
    return at_scale(capture.samples[0], crops.CROP_MM_PX)


@pytest.fixture(scope="module")
def disc():
    """A hand as round as a palm, wide enough for one crop inside."""
    place = np.arange(512) - 255.5
    return (np.hypot(*np.meshgrid(place, place)) < 215).astype(np.float32)


def test_detail_of_the_truth_is_its_own_and_blur_has_less_and_noise_more():
    truth = skin(256)
    power = crops.detail_power(truth)
    blurred = crops.detail_power(ndimage.gaussian_filter(truth, (1, 1, 0))) / power
    noisy = crops.detail_power(truth + np.random.default_rng(1).normal(0, 0.02, truth.shape)) / power
    assert blurred[0] < 0.5
    assert (np.diff(blurred) > 0).all()
    assert blurred[2] > 0.6
    assert (noisy > 1.02).all()
    assert noisy[0] > 1.3


def test_detail_is_told_by_its_wavelength_and_not_by_light_and_shade():
    across = np.arange(256)
    for number, length_px in enumerate((3, 6, 12)):
        wave = np.broadcast_to(0.5 + 0.1 * np.sin(2 * np.pi * across / length_px), (3, 256, 256)).transpose(1, 2, 0)
        power = crops.detail_power(wave)
        assert power.argmax() == number
        assert power[number] > 50 * np.delete(power, number).max()
    slope = np.broadcast_to(across / 256, (3, 256, 256)).transpose(1, 2, 0)
    assert crops.detail_power(slope).max() < 0.01 * power.max()


def test_detail_needs_no_alignment():
    moved = crops.detail_power(np.roll(skin(320), 20, 1)[:256, 40:296]) / crops.detail_power(skin(320)[:256, 20:276])
    assert moved == pytest.approx(1, abs=1e-3)


def test_crops_inside_show_nothing_but_hand_and_those_at_edges_about_half(disc):
    found = crops.places(disc, 100)
    assert len(found[crops.INSIDE]) == 2
    assert len(found[crops.EDGES]) == 3
    assert all(box.of(disc).min() == 1 for box in found[crops.INSIDE])
    assert all(0.25 <= box.of(disc).mean() <= 0.75 for box in found[crops.EDGES])
    first = found[crops.INSIDE][0]
    assert max(abs(first.top + 50 - 256), abs(first.left + 50 - 256)) <= 12
    for boxes in found.values():
        counts = np.zeros(disc.shape)
        for box in boxes:
            box.of(counts)[:] += 1
        assert counts.max() == 1


def test_where_all_is_hand_there_are_no_edges_and_where_none_is_no_crops():
    everywhere, nowhere = (crops.places(np.full((300, 300), value, np.float32), 100) for value in (1, 0))
    assert [len(everywhere[kind]) for kind in (crops.INSIDE, crops.EDGES)] == [2, 0]
    assert not any(nowhere.values())


def test_a_crop_of_1080p_has_256_pixels_and_a_coarser_picture_fewer(sample, disc):
    truth = picture(disc)
    (inside, *_), coarse = (
        crops.crop_scores(one, "novel view", truth.rgb, truth) for one in (sample, at_scale(sample, 0.36))
    )
    assert (inside.kind, inside.side_px) == (crops.INSIDE, 256)
    assert inside.scores["psnr"] == 100
    assert inside.scores["detail_2_4"] == pytest.approx(1)
    assert {crop.side_px for crop in coarse} == {128}
    assert "detail_2_4" not in coarse[-1].scores


def test_the_scale_of_a_close_up_is_that_of_the_part_which_it_shows(sample):
    px, depth_m = sample.camera.project(sample.joints_m)
    nearest = int(np.argmin(depth_m))
    camera = replace(
        sample.camera, width=20, height=20, cx=sample.camera.cx - px[nearest, 0] + 10,
        cy=sample.camera.cy - px[nearest, 1] + 10,
    )  # fmt: skip
    close = crops.millimeters_per_pixel(replace(sample, camera=camera))
    assert close == pytest.approx(1e3 * depth_m[nearest] / camera.fx, rel=1e-3)
    assert close < 0.995 * crops.millimeters_per_pixel(sample)
    beside = replace(sample, camera=replace(camera, cx=camera.cx + 5000))
    assert crops.millimeters_per_pixel(beside) == pytest.approx(crops.millimeters_per_pixel(sample))


def test_a_truth_without_detail_has_none_to_compare(sample, disc):
    flat = TrainingImage(0.6 * np.repeat(disc[..., None], 3, -1), disc)
    inside, *_ = crops.crop_scores(sample, "novel view", picture(disc).rgb, flat)
    assert inside.kind == crops.INSIDE
    assert not any(name.startswith("detail") for name in inside.scores)
    both = crops.crop_means((inside, *crops.crop_scores(sample, "novel view", flat.rgb, picture(disc))[:1]))
    assert both["detail_2_4"] == pytest.approx(0, abs=1e-9)


def test_a_finer_picture_is_averaged_down_to_1080p(sample, disc):
    large = np.kron(disc, np.ones((2, 2), np.float32))
    rgb = np.kron(picture(disc).rgb, np.ones((2, 2, 1), np.float32))
    once = crops.crop_scores(sample, "", skin(512, 1) * disc[..., None], picture(disc))
    ours = np.kron(skin(512, 1) * disc[..., None], np.ones((2, 2, 1), np.float32))
    twice = crops.crop_scores(at_scale(sample, 0.09), "", ours, TrainingImage(rgb, large))
    assert [crop.side_px for crop in twice] == [crop.side_px for crop in once]
    for one, two in zip(once, twice, strict=True):
        assert two.scores == pytest.approx(one.scores, abs=1e-4)


def shown(sample, made):
    return Evaluation("some_avatar", "a capture", "", (PictureScore(sample, "novel view", 0.0, {}, 1.0, made),))


def test_the_table_keeps_scales_apart_and_says_what_is_coarser(capture, sample, disc):
    truth = picture(disc)
    made = [
        crop for mm_px in (0.18, 0.36) for crop in crops.crop_scores(at_scale(sample, mm_px), "v", truth.rgb, truth)
    ]
    table = tables.crops_table(shown(capture.samples[0], tuple(made)))
    assert [row[0] for row in table.rows] == ["v, inside, 0.18 mm", "v, edges, 0.18 mm",
                                              "v, inside, 0.36 mm", "v, edges, 0.36 mm"]  # fmt: skip
    assert any("coarser pictures" in note and "128 pixels" in note for note in table.notes)
    assert any("Ceiling: not measured" in note for note in table.notes)
    inside, edges = (dict(zip(table.columns, row, strict=True)) for row in table.rows[:2])
    assert (inside["detail 2-4 px"], edges["detail 2-4 px"]) == ("1.00", "-")


def test_pictures_of_alike_scales_are_one_row(sample, disc):
    truth = picture(disc)
    made = [
        crop for mm_px in (0.18, 0.19) for crop in crops.crop_scores(at_scale(sample, mm_px), "v", truth.rgb, truth)
    ]
    groups = crops.crop_groups(made)
    assert list(groups) == ["v, inside, 0.18 to 0.19 mm", "v, edges, 0.18 to 0.19 mm"]
    assert sum(map(len, groups.values())) == len(made)
