"""Weights of joints become weights of bones."""

from __future__ import annotations

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import PARENTS
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.limits import WRIST_BLEND_M
from jghand_engine.template.builtin import load_template
from jghand_engine.template.weights import bone_weights, columns_to_level, palm_split, segment_distance, without_crumbs

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


def test_the_palm_has_no_steps():
    """A millimetre on the skin of the palm changes the shares by little; a rigid split would change them by 1."""
    line = np.linspace([-0.04, 0.05, 0.01], [0.04, 0.05, 0.01], 81)
    up = np.linspace([0.01, -0.01, 0.02], [0.01, 0.08, 0.02], 91)
    for walk in (line, up):
        shares = palm_split(walk, JOINTS_M)
        # worst observed 0.10 (the blend to the wrist has slope 1.5 / 15 mm)
        assert np.abs(np.diff(shares, axis=0)).sum(axis=1).max() / 2 < 0.11


def test_shares_stay_finite_far_away():
    shares = palm_split(np.array([[5.0, 5.0, 5.0], [-3.0, 1.0, 2.0]]), JOINTS_M)
    np.testing.assert_allclose(shares.sum(axis=1), 1, atol=1e-15)


def test_columns_are_sorted_like_joints():
    order = JointOrder.MANO16_TIPS
    marks = np.arange(21.0)
    expected = to_level(np.repeat(marks[:, None], 3, axis=1), order)[:, 0]
    np.testing.assert_array_equal(columns_to_level(marks[None], order)[0], expected)


def test_distance_to_a_segment_counts_its_ends():
    points = np.array([[0.0, 1.0, 0.0], [-3.0, 4.0, 0.0], [2.0, 0.0, 1.0], [0.5, 0.0, 0.0]])
    distance = segment_distance(points, np.zeros(3), np.array([1.0, 0.0, 0.0]))
    np.testing.assert_allclose(distance, [1, 5, np.sqrt(2), 0])


def test_crumbs_are_dropped_and_the_rest_sums_to_one():
    weights = without_crumbs(np.array([[0.9995, 0.0005], [0.5, 0.5]]))
    np.testing.assert_array_equal(weights, [[1, 0], [0.5, 0.5]])


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
