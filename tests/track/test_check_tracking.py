"""What scripts/check_tracking.py measures, on a motion that a perfect detector sees."""

import sys
from pathlib import Path

import numpy as np
import pytest
from tracking_samples import CANONICAL_M, right_joints_m, sight

from jghand_engine.hand.joints import Handedness
from jghand_engine.track.track import MOTION_FROM_CAMERA

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))
import check_tracking


@pytest.fixture(scope="module")
def truth():
    return check_tracking.Truth("waving", right_joints_m(40) * MOTION_FROM_CAMERA, Handedness.RIGHT)


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


def test_a_hand_that_is_not_found_has_no_figures(truth):
    (row,) = check_tracking.rows_of_sightings(truth, sight(np.zeros((0, 21, 3))).sightings, CANONICAL_M)
    assert row.cells()[2:] == ["0 of 40", *["-"] * 6]
