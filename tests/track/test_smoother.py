"""Smoothing forwards and backwards at once."""

import numpy as np

from jghand_engine.track.costs import Steadiness
from jghand_engine.track.fit import solve

RANDOM = np.random.default_rng(0)
STEADY = Steadiness(np.array([0.3, 2.0]), np.array([5.0, 0.7]))


def dense(count, steadiness):
    """The matrix of the wish for steadiness, term by term."""
    size = len(steadiness.first)
    first, second = np.zeros((count, count)), np.zeros((count, count))
    for t in range(count - 1):
        row = np.zeros(count)
        row[[t, t + 1]] = -1, 1
        first += np.outer(row, row)
    for t in range(count - 2):
        row = np.zeros(count)
        row[[t, t + 1, t + 2]] = 1, -2, 1
        second += np.outer(row, row)
    whole = np.zeros((count, size, count, size))
    for k in range(size):
        whole[:, k, :, k] = steadiness.first[k] * first + steadiness.second[k] * second
    return whole.reshape(count * size, count * size)


def test_the_banded_solution_is_that_of_the_whole_matrix():
    for count in (1, 2, 3, 9):
        factors = RANDOM.standard_normal((count, 2, 4))
        blocks = factors @ np.swapaxes(factors, -1, -2)
        gradient = RANDOM.standard_normal((count, 2))
        whole = dense(count, STEADY)
        for t in range(count):
            whole[2 * t : 2 * t + 2, 2 * t : 2 * t + 2] += blocks[t]
        expected = -np.linalg.solve(whole, gradient.reshape(-1)).reshape(count, 2)
        np.testing.assert_allclose(solve(blocks, gradient, STEADY), expected, rtol=1e-9, atol=1e-12)


def test_the_gradient_is_that_of_the_cost():
    states = RANDOM.standard_normal((7, 2))
    gradient = STEADY.gradient(np.diff(states, axis=0))
    for place in np.ndindex(states.shape):
        step = np.zeros_like(states)
        step[place] = 1e-6
        costs = [STEADY.cost(np.diff(states + sign * step, axis=0)) for sign in (1, -1)]
        np.testing.assert_allclose((costs[0] - costs[1]) / 2e-6, gradient[place], rtol=1e-6, atol=1e-8)


def test_frames_that_know_nothing_of_one_another_are_solved_alone():
    blocks = np.stack([np.eye(2) * (k + 1) for k in range(4)])
    gradient = RANDOM.standard_normal((4, 2))
    np.testing.assert_allclose(solve(blocks, gradient, None), -gradient / np.arange(1, 5)[:, None])
