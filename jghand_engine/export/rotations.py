"""Rotations as quaternions, by numpy alone; the same signs as scipy's."""

from __future__ import annotations

import numpy as np


def quaternions_xyzw(rotations: np.ndarray) -> np.ndarray:
    """(..., 4) unit quaternions x, y, z, w, float64, from rotation matrices (..., 3, 3).

    The largest of x, y, z, w is computed first and is positive, so that no digits are lost.
    """
    m = np.asarray(rotations, np.float64)
    flat = m.reshape(-1, 3, 3)
    diagonal = np.diagonal(flat, axis1=1, axis2=2)
    trace = diagonal.sum(axis=1)
    largest = np.concatenate([diagonal, trace[:, None]], axis=1).argmax(axis=1)
    found = np.empty((len(flat), 4))
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        some = flat[largest == i]
        found[largest == i, i] = 1 - trace[largest == i] + 2 * some[:, i, i]
        found[largest == i, j] = some[:, j, i] + some[:, i, j]
        found[largest == i, k] = some[:, k, i] + some[:, i, k]
        found[largest == i, 3] = some[:, k, j] - some[:, j, k]
    some = flat[largest == 3]
    found[largest == 3, 0] = some[:, 2, 1] - some[:, 1, 2]
    found[largest == 3, 1] = some[:, 0, 2] - some[:, 2, 0]
    found[largest == 3, 2] = some[:, 1, 0] - some[:, 0, 1]
    found[largest == 3, 3] = 1 + trace[largest == 3]
    found /= np.linalg.norm(found, axis=1, keepdims=True)
    return found.reshape(*m.shape[:-2], 4)
