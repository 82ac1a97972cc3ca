"""Calibrated cameras of data sets -> our Camera. Mistakes are caught here that would only show as a blurred avatar."""

from __future__ import annotations

from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.json_files import numbers
from jghand_engine.render.camera import Camera

# by how much a stored camera rotation may fail to be one: text with six digits
CAMERA_ROTATION_TOLERANCE = 1e-4
# ... and the skew of a camera that is taken for none, px: none of the data sets has any
CAMERA_SKEW_MAX_PX = 1e-3


def calibrated_camera(
    what: str, size_px: tuple[int, int], intrinsics: Any, rotation: Any, translation_m: Any
) -> Camera:
    """The camera x_camera = rotation @ x_world + translation_m with OpenCV axes.

    what: names it in errors · size_px: (width, height) · intrinsics: (3, 3) K in pixels · rotation: (3, 3) ·
    translation_m: (3,) meters. InputError when K is no pinhole without skew, or the rotation is none.
    """
    k, r, t = (
        _finite(what, *part)
        for part in (("K", intrinsics, (3, 3)), ("R", rotation, (3, 3)), ("t", translation_m, (3,)))
    )
    if not (np.allclose(k[2], (0, 0, 1)) and k[1, 0] == 0 and abs(k[0, 1]) < CAMERA_SKEW_MAX_PX):
        raise InputError(f"K of {what}", wanted="[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]", came=str(k.tolist()))
    with np.errstate(over="ignore", invalid="ignore"):
        off = float(np.abs(r @ r.T - np.eye(3)).max())
    if not off <= CAMERA_ROTATION_TOLERANCE or np.linalg.det(r) < 0:
        raise InputError(
            f"rotation of {what}",
            wanted="a rotation matrix, x_camera = R x_world + t",
            came=f"a matrix that is {off:.2g} off" if not off <= CAMERA_ROTATION_TOLERANCE else "a mirroring",
            remedy="Download the camera file again; axes must be OpenCV's (x right, y down, z forward).",
        )
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = r, t
    return Camera(*size_px, k[0, 0], k[1, 1], k[0, 2], k[1, 2], matrix)


def _finite(what: str, part: str, values: Any, shape: tuple[int, ...]) -> np.ndarray:
    array = numbers(values, shape, f"{part} of {what}")
    if not np.isfinite(array).all():
        raise InputError(f"{part} of {what}", wanted="finite numbers", came="NaN or infinity")
    return array
