# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions as this extension and the renderer hand them to each other: `.npz` files that say what they hold.

    joints_m (F, 21, 3) · order "standard" · unit "m" · fps · handedness · filled (F,) and forearm (F, 4) optional

Whatever else there is (other orders, units, formats, gaps) the renderer reads and repairs (`motion_jobs`). Nothing is
ever unpickled. Does not use bpy. Format: DATA 8, `jghand_engine.motion.files`.
"""

from __future__ import annotations

import io
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core.files import write_whole
from ..core.joints import HANDEDNESSES, NAMES
from ..errors import JGHandFailure

# an hour at 120 frames a second is 218 MB as numbers of eight bytes
MAX_BYTES = 512 * 2**20
# frames per second that a motion may have: the renderer's bounds
FPS_MIN, FPS_MAX = 0.1, 10_000.0
# by how much the length of a quaternion may miss 1: single precision
_UNIT = 1e-5


@dataclass(frozen=True)
class MotionFile:
    """joints_m: (F, 21, 3) standard order, meters, whole; notes: what was repaired, in sentences; filled: (F,) bool,
    frames that nobody measured, None where none is known; forearm: (F, 4) how it is turned, see
    `posing.forearm_rotations`, None: as the palm carries it."""

    joints_m: np.ndarray
    fps: float
    handedness: str
    notes: tuple[str, ...] = ()
    filled: np.ndarray | None = None
    forearm: np.ndarray | None = None


def read_motion(path: Path) -> MotionFile:
    """The motion in a file. JGHandFailure (bad_motion): absent, damaged, or not as `write_motion` writes it."""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise ValueError("it is larger than a motion")
        with np.load(path, allow_pickle=False) as content:
            joints = np.asarray(content["joints_m"], dtype=np.float64)
            said = {name: content[name].item() for name in ("order", "unit", "fps", "handedness")}
            filled = content["filled"].astype(bool) if "filled" in content else np.zeros(len(joints), bool)
            forearm = content["forearm"].astype(np.float64) if "forearm" in content else None
            whole = "valid" not in content or content["valid"].all()
        fps = float(said["fps"])
        known = said["order"] == "standard" and said["unit"] == "m" and said["handedness"] in HANDEDNESSES
        if not (known and FPS_MIN <= fps <= FPS_MAX):
            raise ValueError(", ".join(f"{name} {value!r}" for name, value in said.items()))
        if joints.ndim != 3 or joints.shape[1:] != (len(NAMES), 3) or filled.shape != (len(joints),):
            raise ValueError(f"wanted frames x 21 joints x 3, got {joints.shape}")
        if forearm is not None and not (forearm.shape == (len(joints), 4) and _are_turns(forearm)):
            raise ValueError(f"wanted a quaternion of the forearm for each frame, got {forearm.shape}")
        if not (len(joints) and whole and np.isfinite(joints).all()):
            raise ValueError("frames miss joints")
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise JGHandFailure("bad_motion", f"{path}: {str(error)[:200]}") from error
    return MotionFile(joints, fps, said["handedness"], (), filled if filled.any() else None, forearm)


def _are_turns(quaternions: np.ndarray) -> bool:
    return bool((np.abs(np.linalg.norm(quaternions, axis=1) - 1) < _UNIT).all())  # false for NaN, too


def write_motion(path: Path, motion: MotionFile) -> None:
    """Writes `.npz`, everything declared inside; never half-written. JGHandFailure: cannot_write, disk_full."""
    stream = io.BytesIO()
    arrays: dict[str, Any] = {
        "joints_m": np.asarray(motion.joints_m, dtype=np.float64),
        "order": np.array("standard"),
        "unit": np.array("m"),
        "fps": np.array(motion.fps),
        "handedness": np.array(motion.handedness),
        "filled": np.zeros(len(motion.joints_m), bool) if motion.filled is None else motion.filled,
    }
    if motion.forearm is not None:
        arrays["forearm"] = motion.forearm
    np.savez_compressed(stream, **arrays)
    write_whole(path, stream.getvalue())
