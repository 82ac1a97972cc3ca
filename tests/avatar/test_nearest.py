"""The nearest Gaussians, or anchors, of a place."""

import numpy as np
import pytest

from jghand_engine.avatar.nearest import nearest_centers


@pytest.mark.parametrize(("centers", "count"), [(3000, 4), (3, 4), (3000, 8)])
def test_the_nearest_centers_are_those_of_all_that_are_nearest(centers, count):
    """On a sheet as skin is, and far from it."""
    g = np.random.default_rng(4)
    centers_m = g.uniform(-0.05, 0.05, (centers, 3)) * [1, 1, 0.02]
    points_m = np.concatenate([g.uniform(-0.06, 0.06, (700, 3)) * [1, 1, 0.02], g.normal(0, 1, (5, 3))])
    found = nearest_centers(points_m, centers_m, count)
    squares_m2 = ((points_m[:, None] - centers_m) ** 2).sum(-1)
    np.testing.assert_array_equal(np.sort(found), np.sort(np.argsort(squares_m2)[:, :count]))


def test_far_places_few_centers_and_none_are_answered():
    centers = np.zeros((3, 3))
    assert np.sort(nearest_centers(np.full((2, 3), 70.0), centers, 8), 1).tolist() == [[0, 1, 2]] * 2
    assert nearest_centers(np.zeros((0, 3)), centers, 2).shape == (0, 2)


def test_a_place_that_is_not_finite_gets_some_center():
    found = nearest_centers(np.full((2, 3), np.nan), np.zeros((5, 3)), 2)
    assert found.shape == (2, 2)
    assert found.max() < 5
