"""Weights of joints become weights of bones."""

import math

import numpy as np
import pytest

from jghand_engine.avatar.validation import WEIGHT_SUM_TOLERANCE
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import PARENTS
from jghand_engine.template.builtin import load_template
from jghand_engine.template.weights import (
    PALM_SPLIT_SIGMA_M,
    WEIGHT_MIN,
    WRIST_BLEND_M,
    bone_weights,
    check_weight_rows,
    palm_split,
    segment_distance,
    without_crumbs,
)

JOINTS_M = load_template().joints_m


def one_joint(joint):
    return np.eye(21)[[joint]]


@pytest.mark.parametrize("joint", range(1, 16))
def test_the_weight_of_a_joint_goes_to_the_bone_that_starts_there(joint):
    (weights,) = bone_weights(one_joint(joint), JOINTS_M[[joint]], JOINTS_M)
    (bone,) = np.flatnonzero(weights)
    assert PARENTS[bone] == joint


def test_skin_on_a_metacarpal_follows_mostly_that_one():
    for bone in range(2, 6):
        point = 0.9 * JOINTS_M[[bone]]
        (weights,) = bone_weights(one_joint(0), point, JOINTS_M)
        assert weights.argmax() == bone
        assert weights[6:].sum() == 0


def test_skin_at_and_behind_the_wrist_follows_the_palm_alone():
    points = np.array([[0.02, 0, 0.01], [0.0, -0.01, -0.02], [-0.02, -0.3, 0]])
    np.testing.assert_array_equal(palm_split(points, JOINTS_M)[:, 0], 1)
    beyond = np.array([[0.0, WRIST_BLEND_M, 0.02]])
    assert palm_split(beyond, JOINTS_M)[0, 0] == 0


def slow_palm_split(point: np.ndarray, joints: np.ndarray) -> list[float]:
    """METHOD 2.7 for one point, with the distances found by trying a fine scale of places on each metacarpal."""
    part = np.linspace(0, 1, 4001)[:, None]
    distance = [np.linalg.norm(joints[0] + part * (joints[k] - joints[0]) - point, axis=1).min() for k in range(1, 6)]
    near = [math.exp(-(d**2) / (2 * PALM_SPLIT_SIGMA_M**2)) for d in distance]
    height = min(max((point[1] - joints[0][1]) / WRIST_BLEND_M, 0), 1)
    palm = height * height * (3 - 2 * height)
    return [1 - palm, *(palm * value / sum(near) for value in near)]


def test_the_palm_is_split_as_the_method_says():
    random = np.random.default_rng(0)
    joints = JOINTS_M + np.array([0.1, -0.2, 0.3])
    points = joints[0] + random.uniform([-0.04, -0.01, -0.03], [0.04, 0.09, 0.03], (60, 3))
    expected = [slow_palm_split(point, joints) for point in points]
    # 4000 places of a bone of 9 cm: observed 8.6e-8
    np.testing.assert_allclose(palm_split(points, joints), expected, atol=1e-7)


def test_the_palm_has_no_steps():
    """A millimeter on the skin of the palm changes the shares by little; a rigid split would change them by 1."""
    line = np.linspace([-0.04, 0.05, 0.01], [0.04, 0.05, 0.01], 81)
    up = np.linspace([0.01, -0.01, 0.02], [0.01, 0.08, 0.02], 91)
    for walk in (line, up):
        shares = palm_split(walk, JOINTS_M)
        # worst observed 0.10 (the blend to the wrist has slope 1.5 / 15 mm)
        assert np.abs(np.diff(shares, axis=0)).sum(axis=1).max() / 2 < 0.11


def test_shares_stay_finite_far_away():
    shares = palm_split(np.array([[5.0, 5.0, 5.0], [-3.0, 1.0, 2.0]]), JOINTS_M)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-15)


def test_distance_to_a_segment_counts_its_ends():
    points = np.array([[0.0, 1.0, 0.0], [-3.0, 4.0, 0.0], [2.0, 0.0, 1.0], [0.5, 0.0, 0.0]])
    distance = segment_distance(points, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(distance, [1, 5, np.sqrt(2), 0])


def test_crumbs_are_dropped_and_the_rest_sums_to_one():
    weights = without_crumbs(np.array([[0.9995, 0.0005], [0.5, 0.5]]))
    np.testing.assert_array_equal(weights, [[1, 0], [0.5, 0.5]])
    least, below = WEIGHT_MIN, math.nextafter(WEIGHT_MIN, 0)
    np.testing.assert_array_equal(
        without_crumbs(np.array([[1 - least, least], [1 - below, below]])) > 0, [[1, 1], [1, 0]]
    )


def test_rows_may_miss_one_by_rounding():
    check_weight_rows(np.zeros((0, 21)), "weights")
    for part, good in ((0.9, True), (-0.9, True), (1.1, False), (-1.1, False)):
        rows = np.eye(21)[:3]
        rows[1] *= 1 + part * WEIGHT_SUM_TOLERANCE
        if good:
            check_weight_rows(rows, "weights")
        else:
            with pytest.raises(InputError, match="weights: wanted rows that sum to 1"):
                check_weight_rows(rows, "weights")


@pytest.mark.parametrize(
    ("weights", "message"),
    [
        (np.eye(20)[:1], "shape"),
        (np.eye(21)[:1] * 0.9, "sum to 1"),
        (np.eye(21)[:1] * np.nan, "finite"),
        (np.array([[1.5, -0.5, *[0] * 19]]), "at least 0"),
        (np.eye(21)[[20]], "tips"),
    ],
)
def test_what_are_no_weights_is_refused(weights, message):
    with pytest.raises(InputError, match=message):
        bone_weights(weights, np.zeros((1, 3)), JOINTS_M)
