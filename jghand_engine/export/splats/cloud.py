"""Gaussians as splat files know them: centers, sizes along three axes, turns, opacity, color; and in which axes.

Only colors of degree 0 are written: what the skin of a trained avatar mirrors depends on the camera, and is left out,
as are the self-shadow and the texture of a hand's detail.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.hand.rotations import quaternions

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.avatar.posing import PosedHand

# spherical harmonics of band 0: color = 0.5 + SH_C0 * coefficient
SH_C0 = 0.28209479177387814
# maps of column vectors to RUB (x right, y up, z towards the viewer) from a world with that axis up
RUB_FROM_UP = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}
# rdf is what viewers take for granted where a format does not say, as photogrammetry has it: x right, y down, z forward
AXES_FROM_RUB = {"rub": np.eye(3), "rdf": np.diag([1.0, -1.0, -1.0])}


@dataclass(frozen=True)
class SplatCloud:
    """N Gaussians.

    positions_m: (N, 3) meters
    scales_m: (N, 3) sigma, meters
    rotations_wxyz: (N, 4) unit quaternions
    opacity: (N,) 0..1
    rgb: (N, 3) display-referred sRGB 0..1
    axes: those of the numbers, a key of AXES_FROM_RUB
    light: whose the colors show: capture, studio, or scene for one that was told; none of paint; empty: unknown
    """

    positions_m: np.ndarray
    scales_m: np.ndarray
    rotations_wxyz: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray
    axes: str = "rub"
    light: str = ""

    def __len__(self) -> int:
        return len(self.positions_m)

    @classmethod
    def of_frame(cls, posed: PosedHand, avatar: HandAvatar, *, axes: str, up: str, light: str = "") -> SplatCloud:
        """The Gaussians of a frame, whose world has the axis `up` upwards, in `axes`. avatar: that was posed."""
        axes_from_world = AXES_FROM_RUB[axes] @ RUB_FROM_UP[up]
        scales_m, rotations = _shapes(posed.sigma_m, posed.covariance_m2, axes_from_world)
        count = len(posed.position_m)
        return cls(
            posed.position_m @ axes_from_world.T,
            np.broadcast_to(scales_m, (count, 3)),
            np.broadcast_to(rotations, (count, 4)),
            np.asarray(avatar.opacity, np.float32),
            np.clip(np.asarray(avatar.rgb, np.float32) if posed.rgb is None else posed.rgb, 0, 1),
            axes,
            light,
        )


def _shapes(
    sigma_m: np.ndarray, covariance_m2: np.ndarray | None, axes_from_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    if covariance_m2 is None:
        return sigma_m[:, None], np.array([[1.0, 0.0, 0.0, 0.0]])
    scales_m, axes = _scales_and_axes(covariance_m2, axes_from_world)
    return scales_m, quaternions(axes)


def _scales_and_axes(
    covariance_m2: np.ndarray, axes_from_world: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Standard deviations (N, 3) meters along the axes of ellipsoids, and these axes as columns (N, 3, 3).

    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz
    axes_from_world: (3, 3) a turn of everything
    """
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
        """Sizes (N, 3) meters and quaternions (N, 4) as x, y, z, w, float32, of covariances (N, 6)
        xx, xy, xz, yy, yz, zz."""
        scales_m, axes = _scales_and_axes(covariance_m2)
        if self._axes is not None:
            # trace(last^T now R) is the larger, the nearer the axes are
            between = np.einsum("nki,nkj->nij", self._axes, axes)
            nearness = between.reshape(-1, 9) @ np.swapaxes(_AXES_OF_AXES, 1, 2).reshape(-1, 9).T
            numbered = _AXES_OF_AXES[nearness.argmax(axis=1)]
            axes = np.einsum("nij,njk->nik", axes, numbered)
            scales_m = np.einsum("nj,njk->nk", scales_m, np.abs(numbered))
        turns_xyzw = quaternions(axes)[:, [1, 2, 3, 0]]
        if self._turns_xyzw is not None:
            turns_xyzw *= np.where((turns_xyzw * self._turns_xyzw).sum(axis=1, keepdims=True) < 0, -1.0, 1.0)
        self._axes, self._turns_xyzw = axes, turns_xyzw
        return scales_m.astype(np.float32), turns_xyzw.astype(np.float32)
