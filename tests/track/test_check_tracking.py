"""What scripts/check_tracking.py measures, on a motion that a perfect detector sees."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tracking_samples import CAMERA, CANONICAL_M, HEIGHT, WIDTH, right_joints_m, sight

from jghand_engine.hand.joints import Handedness
from jghand_engine.track import fit
from jghand_engine.track.track import MOTION_FROM_CAMERA

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
import check_tracking


@pytest.fixture(scope="module")
def truth():
    return check_tracking.Truth("waving", right_joints_m(40) * MOTION_FROM_CAMERA, Handedness.RIGHT)


def test_its_camera_is_that_of_the_pictures(truth):
    assert check_tracking.SIZE_PX == (WIDTH, HEIGHT)
    assert truth.pinhole == CAMERA


def test_every_method_of_a_perfect_detector_is_near_the_truth(truth):
    rows = {
        row.method: row
        for row in check_tracking.rows_of_sightings(truth, sight(right_joints_m(40)).sightings, CANONICAL_M)
    }
    assert rows["the truth itself"].in_space == (0.0, 0.0)
    assert rows["detector alone"].in_space[1] < 1e-9
    assert rows["**jghand track**"].in_space[0] < 0.4, "seen: 0.30 degrees"
    assert abs(rows["**jghand track**"].lag_ms) <= 2
    assert rows["detector, one-euro filter"].lag_ms > 60, "a filter that lags is seen to lag; seen: 69 ms"
    assert all(row.seen == "40 of 40" for row in rows.values())


def test_a_hand_at_the_border_is_measured_with_directions_turned_to_its_ray_too(truth):
    joints = right_joints_m(40) + np.array([0.2, 0.0, 0.0])
    wide = replace(truth, joints_m=joints * MOTION_FROM_CAMERA, angle_deg=check_tracking.WIDE_DEG)
    # a detector that takes the way it looks for the camera's axis: what is turned back by the whole angle is right
    turned = check_tracking.turned_to_the_ray(sight(joints).sightings, CAMERA, -1.0)
    back = check_tracking.turned_to_the_ray(turned, CAMERA, 1.0)
    for first, second in zip(back.frames, sight(joints).sightings.frames, strict=True):
        np.testing.assert_allclose(first[0].space_m, second[0].space_m, atol=1e-15)
    methods = [row.method for row in check_tracking.rows_of_sightings(wide, turned, CANONICAL_M)]
    assert sum("turned to the hand's ray" in method for method in methods) == 2


def test_a_hand_that_is_not_found_has_no_figures(truth):
    (row,) = check_tracking.rows_of_sightings(truth, sight(np.zeros((0, 21, 3))).sightings, CANONICAL_M)
    assert row.cells()[2:] == ["0 of 40", *["-"] * 6]


def test_landmarks_of_a_hand_that_a_perfect_detector_sees_are_not_missed():
    cells = check_tracking.misses_of(sight(right_joints_m(40)).sightings, CANONICAL_M)
    assert float(cells[1][1]) < 0.1, "seen: 0.0 px"
    assert float(cells[0][1]) < 2, "laid flat, as if from far away; seen: 1.6 px"


def test_gaps_that_are_made_in_a_steady_motion_are_filled_with_it(monkeypatch):
    monkeypatch.setattr(check_tracking, "GAPS", (2, 5))
    monkeypatch.setattr(check_tracking, "GAP_BESIDE", 10)
    steady = np.broadcast_to(right_joints_m(1), (40, 21, 3))
    rows = list(check_tracking.gaps_of(sight(steady).sightings, CANONICAL_M))
    assert rows == [["2", "0.0", "0.0", "0.0"], ["5", "0.0", "0.0", "0.0"]]
    moving = list(check_tracking.gaps_of(sight(right_joints_m(40)).sightings, CANONICAL_M))
    assert float(moving[1][3]) > 0.1, "what moves is missed"


def test_limits_that_a_measurement_changes_are_put_back_after_an_error():
    before = fit.FIT_GAP_S, fit.FIT_REACH_S
    with pytest.raises(ZeroDivisionError), check_tracking.gaps_filled_by_the_fit(by_fit=True):
        raise ZeroDivisionError
    assert before == (fit.FIT_GAP_S, fit.FIT_REACH_S)


def test_tables_are_put_into_the_page_between_its_marks(tmp_path, monkeypatch):
    page = tmp_path / "page.md"
    page.write_text(f"before\n{check_tracking.BEGIN}\nold\n{check_tracking.END}\nafter\n")
    monkeypatch.setattr(check_tracking, "PAGE", page)
    check_tracking.put_into_page(check_tracking.table(["what", "how much"], [["\\1", "2"]]))
    assert page.read_text().splitlines()[1:6] == [
        check_tracking.BEGIN, "| what | how much |", "| --- | ---: |", "| \\1 | 2 |", check_tracking.END,
    ]  # fmt: skip
