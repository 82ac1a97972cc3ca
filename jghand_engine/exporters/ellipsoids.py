"""Ellipsoids as files know them: sizes along three axes and a turn, of a covariance."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation


def scales_and_turns(
    covariance_m2: np.ndarray, axes_from_world: np.ndarray | None = None
) -> tuple[np.ndarray, Rotation]:
    """Standard deviations (N, 3) metres along the axes of ellipsoids, and the N turns of these axes.

    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz · axes_from_world: (3, 3) a turn of everything
    """
    xx, xy, xz, yy, yz, zz = covariance_m2.astype(np.float64).T
    whole = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).reshape(-1, 3, 3)
    if axes_from_world is not None:
        whole = axes_from_world @ whole @ axes_from_world.T
    variances, axes = np.linalg.eigh(whole)
    # a rotation has no mirror image in it
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    smallest = np.finfo(np.float32).tiny
    return np.sqrt(np.maximum(variances, smallest)), Rotation.from_matrix(axes)
