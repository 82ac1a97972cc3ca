"""Gaussians as splat files know them: centers, sizes along three axes, turns, opacity, color; and in which axes.

Only colors of degree 0 are written: what the skin of a trained avatar mirrors depends on the camera, and is left out,
as is the self-shadow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from jghand_engine.export.splats.ellipsoids import scales_and_turns

if TYPE_CHECKING:
    from jghand_engine.avatar.avatar import HandAvatar
    from jghand_engine.avatar.fast_posing import PosedFrame

# maps of column vectors to RUB (x right, y up, z towards the viewer) from a world with that axis up
RUB_FROM_UP = {"y": np.eye(3), "z": np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])}
# rdf is what viewers take for granted where a format does not say, as photogrammetry has it: x right, y down, z forward
AXES_FROM_RUB = {"rub": np.eye(3), "rdf": np.diag([1.0, -1.0, -1.0])}


@dataclass(frozen=True)
class SplatCloud:
    """N Gaussians. positions_m (N, 3) meters · scales_m (N, 3) sigma, meters · rotations_wxyz (N, 4) unit quaternions ·
    opacity (N,) 0..1 · rgb (N, 3) display-referred sRGB 0..1 · axes: those of the numbers, a key of AXES_FROM_RUB."""

    positions_m: np.ndarray
    scales_m: np.ndarray
    rotations_wxyz: np.ndarray
    opacity: np.ndarray
    rgb: np.ndarray
    axes: str = "rub"

    def __len__(self) -> int:
        return len(self.positions_m)

    @classmethod
    def of_frame(cls, posed: PosedFrame, avatar: HandAvatar, *, axes: str, up: str) -> SplatCloud:
        """The Gaussians of a frame, whose world has the axis `up` upwards, in `axes`. avatar: that was posed."""
        axes_from_world = AXES_FROM_RUB[axes] @ RUB_FROM_UP[up]
        scales_m, rotations = _shapes(posed.sigma_m, posed.covariance_m2, axes_from_world)
        count = len(posed.positions_m)
        return cls(
            posed.positions_m @ axes_from_world.T,
            np.broadcast_to(scales_m, (count, 3)),
            np.broadcast_to(rotations, (count, 4)),
            avatar.opacity.numpy().astype(np.float32),
            np.clip(avatar.rgb.numpy().astype(np.float32) if posed.rgb is None else posed.rgb, 0, 1),
            axes,
        )


def _shapes(
    sigma_m: np.ndarray, covariance_m2: np.ndarray | None, axes_from_world: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Scales and rotations: of balls, or of ellipsoids (N, 6) by the axes of their covariance."""
    if covariance_m2 is None:
        return sigma_m[:, None], np.array([[1.0, 0.0, 0.0, 0.0]])
    scales_m, turns = scales_and_turns(covariance_m2, axes_from_world)
    return scales_m, turns.as_quat(scalar_first=True)
