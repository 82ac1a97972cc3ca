# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a bake that a Blender without USD plays: one `.splat` file per frame, read by the extension alone.

    NAME.cache/NAME.0001.splat    32 bytes per Gaussian: position and sigma as 3 float32 each, color and opacity as 4
                                  bytes of sRGB, rotation as 4 bytes; x right, y down, z forward

Source: EXPORT 9, `jghand_engine.export.splats.files`. Does not use bpy.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core import limits
from ..core.film import linear_of
from ..errors import JGHandFailure

_GAUSSIAN = np.dtype([("position", "<f4", 3), ("sigma", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
# the file's axes to a world with z up: its y points down, its z forward
_WORLD_FROM_FILE = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]], np.float32)


@dataclass(frozen=True)
class CachedFrame:
    """positions_m: (N, 3) in the world, z up · radius_m: (N,) one standard deviation · rgba: (N, 4) linear light and
    opacity, 0..1; float32."""

    positions_m: np.ndarray
    radius_m: np.ndarray
    rgba: np.ndarray


def cache_folder(folder: Path, name: str) -> Path:
    """Where the frames of a baked hand lie."""
    return folder / f"{name}.cache"


def frame_path(folder: Path, name: str, frame: int) -> Path:
    """The file of one frame of the scene."""
    return cache_folder(folder, name) / f"{name}.{frame:04d}.splat"


def read_frame(path: Path) -> CachedFrame:
    """One frame. JGHandFailure (no_bake): it is not there, or damaged."""
    try:
        size = path.stat().st_size
        if not size or size % _GAUSSIAN.itemsize or size > limits.CACHE_FRAME_MAX_BYTES:
            raise JGHandFailure("no_bake", f"{path}: {size} bytes are no frame")
        table = np.fromfile(path, _GAUSSIAN)
    except OSError as error:
        raise JGHandFailure("no_bake", f"{path}: {error.strerror or error}") from error
    if not np.isfinite(table["position"]).all() or not np.isfinite(table["sigma"]).all():
        raise JGHandFailure("no_bake", f"{path}: numbers that are not finite")
    rgba = table["rgba"].astype(np.float32) / 255
    rgba[:, :3] = linear_of(rgba[:, :3])
    return CachedFrame(table["position"] @ _WORLD_FROM_FILE.T, table["sigma"].max(axis=1), rgba)
