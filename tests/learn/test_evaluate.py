"""Evaluation: which pictures are measured, how figures are gathered, and the tables that show them."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from picture_sets import LEFT, RIGHT, pose
from small_avatars import on_template

from jghand_engine.captures.sample import MaskSource, load_image
from jghand_engine.captures.splits import split_by_rule
from jghand_engine.errors import InputError
from jghand_engine.hand.sequence import HandPose
from jghand_engine.learn import tables
from jghand_engine.learn.evaluate import (
    AvatarPicturer,
    Evaluation,
    categories_of,
    finger_flexion_deg,
    measure_pictures,
    pictured,
)
from jghand_engine.learn.perceptual import PerceptualMetric
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings


def truth_but(capture, error):
    """Draws the very truth, `error` brighter on the hand."""
    by_camera = {(id(s.camera), s.joints_m.tobytes()): s for s in capture.samples}

    def draw(hand, handedness, camera):
        picture = load_image(by_camera[id(camera), hand.joints_m.tobytes()])
        rgb = picture.rgb + error * (picture.mask[..., None] >= 0.5)
        return np.concatenate([rgb, picture.mask[..., None]], -1).astype(np.float32)

    return draw


@pytest.fixture(scope="module")
def evaluation(capture, split):
    pictures = measure_pictures(categories_of(split, "test"), truth_but(capture, 0.1))
    return Evaluation("some_avatar", capture.name, split.origin, pictures)


def test_the_truth_itself_scores_perfectly(capture, split):
    pictures = measure_pictures({"all": split.test[:2]}, truth_but(capture, 0.0))
    for picture in pictures:
        assert picture.scores["psnr_full"] == picture.scores["psnr_box"] == picture.scores["psnr_mask"] == 100
        assert picture.scores["ssim_full"] == pytest.approx(1, abs=1e-6)


def test_a_constant_error_on_the_hand_is_20_db_there_and_more_around_it(evaluation):
    for picture in evaluation.pictures:
        assert picture.scores["psnr_mask"] == pytest.approx(20, abs=1e-4)
        assert picture.scores["psnr_mask"] < picture.scores["psnr_box"] < picture.scores["psnr_full"]


def test_the_time_of_a_picture_is_that_of_drawing_it_in_milliseconds(split):
    def draw(hand, handedness, camera):
        time.sleep(0.01)
        return np.zeros((camera.height, camera.width, 4), np.float32)

    started = time.perf_counter()
    *_, render_ms = pictured(split.test[0], draw)
    assert 10 <= render_ms <= 1e3 * (time.perf_counter() - started)


def test_every_picture_is_measured_once_and_ticked(capture, split):
    ticks = []
    categories = categories_of(split, "test")
    pictures = measure_pictures(categories, truth_but(capture, 0.1), tick=lambda: ticks.append(1))
    assert [p.sample for p in pictures] == [s for group in categories.values() for s in group] == list(split.test)
    assert len(ticks) == len(split.test)


def test_categories_are_those_of_the_split(split):
    assert list(categories_of(split, "test")) == ["novel pose", "novel view", "both novel"]
    assert list(categories_of(split, "train")) == ["learnt"]
    assert list(categories_of(split, "all")) == ["novel pose", "novel view", "both novel", "learnt"]


def test_a_split_without_held_out_pictures_is_told(capture):
    with pytest.raises(InputError, match="take another --split"):
        categories_of(split_by_rule(capture, 99, 99), "test")


@pytest.mark.parametrize("handedness", [RIGHT, LEFT])
def test_flexion_tells_an_open_hand_from_a_fist(handedness):
    assert finger_flexion_deg(pose(0, handedness), handedness) < 10
    assert 75 < finger_flexion_deg(pose(1, handedness), handedness) < 95


def test_perceptual_metrics_are_taken_on_the_picture_and_on_the_box(capture, split):
    metric = PerceptualMetric("ST-LPIPS", "", lambda x: [x], (torch.ones(1, 3, 1, 1),))
    (picture,) = measure_pictures({"one": split.test[:1]}, truth_but(capture, 0.1), perceptual=[metric])
    assert picture.scores["st_lpips_box"] > picture.scores["st_lpips_full"] > 0


def test_a_picture_is_drawn_with_the_forearm_turned_as_it_is_in_it(capture):
    arm, turn = on_template(forearm=True), np.array([0.98, 0.0, 0.199, 0.0])
    sample = replace(capture.samples[0], forearm=turn)
    settings = RenderSettings(antialias=False)
    drawn, straight = (pictured(one, AvatarPicturer(arm, settings))[0] for one in (sample, capture.samples[0]))
    wanted = HandRenderer(arm, settings).render(HandPose(sample.joints_m, turn), sample.camera).rgba
    assert np.array_equal(drawn, wanted)
    assert np.abs(drawn - straight).max() > 0.5


# ---- tables ---------------------------------------------------------------------------------------------------------


def cells_of(table, first):
    return next(row for row in table.rows if row[0] == first)


def test_the_papers_table_keeps_its_figures_and_ours_in_columns_of_their_own(evaluation):
    table = tables.rendering_table([evaluation])
    assert table.columns == ("SSIM / PSNR / LPIPS", *tables.PAPER_SETS, evaluation.capture)
    assert cells_of(table, "JGHand (paper)")[1] == "0.966 / 33.44 / 0.032"
    assert cells_of(table, "JGHand (paper)")[-1] == "-"
    ours = cells_of(table, "some_avatar: all")
    assert ours[1:-1] == ("-",) * 4
    assert ours[-1].endswith("/ -"), "no LPIPS was measured"
    assert tables.CAVEAT in table.notes


@pytest.mark.parametrize("who", tables.PAPER_RENDERING)
def test_the_papers_figures_are_those_of_the_page(who):
    page = (Path(__file__).parents[2] / "docs" / "PAPER.md").read_text(encoding="utf-8")
    cells = [
        "{:.3f} / {:.2f} / {:.3f}".format(*cell) if cell else "\N{EN DASH}" for cell in tables.PAPER_RENDERING[who]
    ]
    assert " | ".join(cells).replace(" 0.", " .").removeprefix("0") in page


def test_an_st_lpips_is_never_put_into_the_column_of_lpips(evaluation):
    picture = evaluation.pictures[0]
    scored = type(picture)(picture.sample, picture.category, 0.0, {**picture.scores, "st_lpips_full": 0.123}, 1.0)
    one = Evaluation("a", "b", "c", (scored,))
    assert "0.123" not in tables.rendering_table([one]).markdown()
    shown = tables.figures_table(one, "full")
    assert "ST-LPIPS" in shown.columns
    assert "LPIPS" not in shown.columns
    assert any("not comparable" in note for note in shown.notes)


def test_columns_of_the_box_are_of_the_box(evaluation):
    """Figures as no picture has them, so that a cell tells where it is from."""
    picture = evaluation.pictures[0]
    known = {"psnr_full": 11.0, "psnr_box": 22.0, "psnr_mask": 33.0, "ssim_full": 0.1, "ssim_box": 0.2}
    one = Evaluation("a", "b", "c", (replace(picture, scores=known),))
    for table, wanted in (
        (tables.figures_table(one, "box"), {"PSNR dB": "22.00", "mask PSNR dB": "33.00", "SSIM": "0.2000"}),
        (tables.figures_table(one, "full"), {"PSNR dB": "11.00", "SSIM": "0.1000"}),
        (tables.flexion_table(one), {"PSNR dB": "22.00", "mask PSNR dB": "33.00", "SSIM": "0.2000"}),
    ):
        assert dict(zip(table.columns[2:], table.rows[0][2:], strict=True)) == wanted
    row = next(row for row in tables.ablation_table({"full": one}).rows if row[0] == "full")
    assert (row[2], row[4]) == ("11.00", "22.00")


def test_the_ablation_says_what_each_variant_loses(capture, split, evaluation):
    worse = Evaluation("w/o screen shadow", capture.name, split.origin,
                       measure_pictures(categories_of(split, "test"), truth_but(capture, 0.2)))  # fmt: skip
    table = tables.ablation_table({"full": evaluation, "w/o screen shadow": worse})
    row = cells_of(table, "w/o screen shadow")
    assert float(row[3]) == pytest.approx(-20 * np.log10(2), abs=0.01)
    assert row[5:] == ("0.954", "30.92", "-2.52")
    assert cells_of(table, "w/o trans")[1:5] == ("-",) * 4


def test_masks_of_our_own_silhouette_are_told(evaluation):
    assert not any("projected" in note for note in tables.figures_table(evaluation, "box").notes)
    picture = evaluation.pictures[0]
    sample = replace(picture.sample, mask_source=MaskSource.TEMPLATE)
    ours = Evaluation("a", "b", "c", (replace(picture, sample=sample),))
    for table in (tables.figures_table(ours, "box"), tables.rendering_table([ours])):
        assert any("projected" in note for note in table.notes)
