"""Gaussians as splat files know them: centers, sizes along three axes, turns, opacity, color; and in which axes.

Only colors of degree 0 are written: what the skin of a trained avatar mirrors depends on the camera, and is left out,
as is the self-shadow. Of the texture of a hand's detail they have the means under the Gaussians, or that on surfels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
