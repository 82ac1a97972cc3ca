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
