"""Sheets: which pictures they show, where they stand, and poses between poses."""

import numpy as np
import pytest
from picture_sets import LEFT, recorded, write_set

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.masks import template_mask
from jghand_engine.hand.sequence import HandPose
from jghand_engine.learn import sheets
from jghand_engine.learn.evaluate import measure_pictures


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return open_capture(write_set(tmp_path_factory.mktemp("set"), recorded(LEFT, frames=3, cameras=3)))


def draw(hand, handedness, camera):
    """The silhouette of the template in one color."""
    mask = template_mask(camera, HandPose.of(hand).joints_m, handedness)[..., None]
    return np.concatenate([mask * [0.8, 0.6, 0.5], mask], -1).astype(np.float32)


def rows_and_columns(sheet):
    """How many cells stand above and beside each other: the ground's color starts and ends."""
    ground = np.round(255 * np.array(sheets._GROUND)).astype(int)
    is_cell = np.abs(sheet.astype(int) - ground).max(-1) <= 1
    down = is_cell.sum(1) > 0.02 * sheet.shape[1]
    across = is_cell.sum(0) > 0.02 * sheet.shape[0]
    return tuple(int((np.diff(line.astype(int)) == 1).sum() + line[0]) for line in (down, across))


def test_comparisons_are_truth_ours_and_difference(capture):
    pictures = measure_pictures({"all": capture.samples[:2]}, draw)
    sheet = sheets.comparison_sheet(pictures, draw, "title")
    assert sheet.dtype == np.uint8
    assert rows_and_columns(sheet)[1] == 6
    assert rows_and_columns(sheets.comparison_sheet(pictures[:1], draw, "title"))[1] == 3


def test_the_best_and_the_worst_are_always_shown(capture):
    pictures = measure_pictures({"all": capture.samples[:5]}, draw)
    shown = sheets.from_best_to_worst(pictures, 3)
    figures = [picture.scores["psnr_full"] for picture in shown]
    everything = [picture.scores["psnr_full"] for picture in pictures]
    assert figures == sorted(figures, reverse=True)
    assert (figures[0], figures[-1]) == (max(everything), min(everything))
    assert len(sheets.from_best_to_worst(pictures, 99)) == len(pictures)


def test_variants_stand_beside_the_truth_in_a_row_for_each_picture(capture):
    sheet = sheets.variant_sheet(capture.samples[:2], {"one": draw, "other": draw}, "title")
    assert rows_and_columns(sheet) == (2, 3)


def test_poses_between_two_stand_in_a_row_for_each_drawer_and_views_in_one_for_each_picture(capture):
    pair = capture.samples[0], capture.by_pose()[capture.poses[1]][0]
    between = sheets.between_sheet([pair], {"one": draw, "other": draw}, "title")
    assert rows_and_columns(between) == (2, sheets.SHEET_STEPS_BETWEEN + 2)
    views = sheets.view_sheet(capture.samples[:2], draw, "title")
    assert rows_and_columns(views) == (2, len(sheets.VIEWS))


def test_poses_show_each_pose_once(capture):
    chosen = sheets.varied_samples(capture.samples, 12)
    assert len(chosen) == len(capture.poses) == len({sample.pose for sample in chosen})
    assert len({sample.camera_name for sample in chosen}) == 3


def test_the_ends_of_a_way_are_the_poses_and_the_wrist_stays(capture):
    first, second = capture.samples[0], capture.by_pose()[capture.poses[1]][0]
    hands = sheets.hands_between(first, second, np.linspace(0, 1, 6))
    np.testing.assert_allclose(hands[0], first.joints_m, atol=1e-9)  # worst observed 1e-16
    np.testing.assert_allclose(hands[:, 0], np.tile(first.joints_m[0], (6, 1)), atol=1e-9)

    def gaps(joints_m):
        return np.linalg.norm(joints_m[:, None] - joints_m[None], axis=-1)

    np.testing.assert_allclose(gaps(hands[-1]), gaps(second.joints_m), atol=1e-9)  # worst observed 2e-16
