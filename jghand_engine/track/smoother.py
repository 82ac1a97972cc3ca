"""Smoothing forwards and backwards at once: the linear algebra of it.

A state of n numbers per frame, what each frame's measurement says of it, and a wish for small changes of speed from
frame to frame give one banded system of equations. Its solution is what a Kalman filter with a Rauch-Tung-Striebel
smoother finds for the same model; it looks as far ahead as back, so it has no lag, and it closes gaps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded


@dataclass(frozen=True)
class Steadiness:
    """How little the n numbers of a state may change: weights (1 / variance per frame) of the difference between
    neighboring frames and of the difference of those. first, second: (n,)"""

    first: np.ndarray
    second: np.ndarray

    def cost(self, steps: np.ndarray) -> float:
        """Half the weighted square of everything unsteady. steps: (F - 1, n) from each frame to the next."""
        return 0.5 * float((self.first * steps**2).sum() + (self.second * np.diff(steps, axis=0) ** 2).sum())

    def gradient(self, steps: np.ndarray) -> np.ndarray:
        """(F, n) derivative of the cost with respect to the states."""
        pull = self.first * steps
        change = self.second * np.diff(steps, axis=0)
        pull[1:] += change
        pull[:-1] -= change
        gradient = np.zeros((len(steps) + 1, steps.shape[1]))
        gradient[1:] += pull
        gradient[:-1] -= pull
        return gradient


def solve(blocks: np.ndarray, gradient: np.ndarray, steadiness: Steadiness | None) -> np.ndarray:
    """The step (F, n) that a Newton method takes: -(H + D)^-1 g.

    blocks: (F, n, n) second derivatives of what is measured in each frame, positive definite · gradient: (F, n) of
    everything · steadiness: None for frames that know nothing of one another.
    """
    count, size = gradient.shape
    if steadiness is None or count == 1:
        return -np.linalg.solve(blocks, gradient[..., None])[..., 0]
    band = np.zeros((2 * size + 1, count, size))
    for row in range(size):
        for column in range(row + 1):
            band[row - column, :, column] = blocks[:, row, column]
    first, second = steadiness.first, steadiness.second
    band[0, 1:] += first
    band[0, :-1] += first
    band[size, :-1] -= first
    if count > 2:
        band[0, :-2] += second
        band[0, 1:-1] += 4 * second
        band[0, 2:] += second
        band[size, :-2] -= 2 * second
        band[size, 1:-1] -= 2 * second
        band[2 * size, :-2] += second
    flat = band.reshape(2 * size + 1, count * size)
    try:
        return -solveh_banded(flat, gradient.reshape(-1), lower=True, check_finite=False).reshape(count, size)
    except LinAlgError:
        # rounding made it indefinite: a longer diagonal is a shorter step, which is what the caller would try next
        flat[0] *= 1 + 1e-3
        return -solveh_banded(flat, gradient.reshape(-1), lower=True, check_finite=False).reshape(count, size)
