"""Ellipsoids as files know them: sizes along three axes and a turn, of a covariance."""

from __future__ import annotations

import itertools

import numpy as np
from scipy.spatial.transform import Rotation


def scales_and_turns(
    covariance_m2: np.ndarray, axes_from_world: np.ndarray | None = None
) -> tuple[np.ndarray, Rotation]:
    """Standard deviations (N, 3) meters along the axes of ellipsoids, and the N turns of these axes.

    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz · axes_from_world: (3, 3) a turn of everything
    """
    scales_m, axes = _scales_and_axes(covariance_m2, axes_from_world)
    return scales_m, Rotation.from_matrix(axes)


def _scales_and_axes(
    covariance_m2: np.ndarray, axes_from_world: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """The same with the turns as matrices (N, 3, 3)."""
    xx, xy, xz, yy, yz, zz = covariance_m2.astype(np.float64).T
    whole = np.stack([xx, xy, xz, xy, yy, yz, xz, yz, zz], -1).reshape(-1, 3, 3)
    if axes_from_world is not None:
        whole = axes_from_world @ whole @ axes_from_world.T
    variances, axes = np.linalg.eigh(whole)
    # a rotation has no mirror image in it
    axes[:, :, 0] *= np.sign(np.linalg.det(axes))[:, None]
    smallest = np.finfo(np.float32).tiny
    return np.sqrt(np.maximum(variances, smallest)), axes


# the turns that put three axes onto each other: (24, 3, 3)
_AXES_OF_AXES = np.array([
    matrix
    for order in itertools.permutations(range(3))
    for signs in itertools.product((1.0, -1.0), repeat=3)
    if np.linalg.det(matrix := np.diag(signs)[:, list(order)]) > 0
])  # fmt: skip


class SteadyAxes:
    """Ellipsoids frame after frame, for files whose readers interpolate between frames.

    Of a covariance alone neither the order of the axes nor their signs is known, and half way between two choices lies
    another shape. So each ellipsoid's axes are numbered as those that they are nearest to in the frame before, and its
    quaternion is in the same hemisphere.
    """

    def __init__(self) -> None:
        self._axes: np.ndarray | None = None
        self._turns_xyzw: np.ndarray | None = None

    def __call__(self, covariance_m2: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sizes (N, 3) meters and quaternions (N, 4) as x, y, z, w, float32, of (N, 6) as in `scales_and_turns`."""
        scales_m, axes = _scales_and_axes(covariance_m2)
        if self._axes is not None:
            # trace(last^T now R) is the larger, the nearer the axes are
            between = np.einsum("nki,nkj->nij", self._axes, axes)
            nearness = between.reshape(-1, 9) @ np.swapaxes(_AXES_OF_AXES, 1, 2).reshape(-1, 9).T
            numbered = _AXES_OF_AXES[nearness.argmax(axis=1)]
            axes = np.einsum("nij,njk->nik", axes, numbered)
            scales_m = np.einsum("nj,njk->nk", scales_m, np.abs(numbered))
        turns_xyzw = Rotation.from_matrix(axes).as_quat()
        if self._turns_xyzw is not None:
            turns_xyzw *= np.where((turns_xyzw * self._turns_xyzw).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
        self._axes, self._turns_xyzw = axes, turns_xyzw
        return scales_m.astype(np.float32), turns_xyzw.astype(np.float32)
