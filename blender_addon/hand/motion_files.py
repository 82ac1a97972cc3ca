# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions in files that say what they hold: `.npz`, `.json` and `.csv`, as `jghand` writes them. No engine needed.

The files declare order, unit, frames per second and handedness; what is not declared is refused, because a wrong order
or unit would go unnoticed until the picture. Frames that miss a joint hold the last whole pose, and that is told.
Nothing is ever unpickled. Formats: DATA 8, `jghand_engine.motion.files`, which also reads other orders.

    .npz   joints_m (F, 21, 3) · order · unit · fps · handedness · valid (F, 21) and filled (F,) optional
    .json  {"format": "jghand motion", "version": 1, "order", "unit", "fps", "handedness", "joints": [[[x, y, z], …]]};
           "filled", optional, lists numbers of frames
    .csv   comment lines `# unit: m` and so on (`# filled: 3 4 5` optional), a header with wrist_x, wrist_y, …, a line
           per frame, empty cells missing
"""

from __future__ import annotations

import csv
import io
import json
import math
import struct
import tokenize
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core import limits
from ..core.files import write_whole
from ..core.joints import FINGERS, HANDEDNESSES, NAMES
from ..core.posing import last_good_frames
from ..errors import JGHandFailure

_METERS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
# for each joint of the standard order its place in the file's order: level by level, and the standard itself
_LEVEL = ("wrist", *(f"{finger}{level}" for level in (1, 2, 3, 4) for finger in FINGERS))
_ORDERS = {"standard": tuple(range(len(NAMES))), "level": tuple(_LEVEL.index(name) for name in NAMES)}
_DECLARED = ("order", "unit", "fps", "handedness")
_COLUMNS = [f"{name}_{axis}" for name in NAMES for axis in "xyz"]
# what numpy, json, zip and csv raise on a damaged or hostile file
_DAMAGE = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, EOFError, OverflowError, SyntaxError),
    *(RecursionError, NotImplementedError, RuntimeError, zipfile.BadZipFile, csv.Error, tokenize.TokenError),
    struct.error,
)


@dataclass(frozen=True)
class MotionFile:
    """joints_m: (F, 21, 3) standard order, meters, whole; notes: what was repaired, in sentences; filled: (F,) bool,
    frames that nobody measured, None where none is known."""

    joints_m: np.ndarray
    fps: float
    handedness: str
    notes: tuple[str, ...] = ()
    filled: np.ndarray | None = None


def read_motion(path: Path) -> MotionFile:
    """The motion in a file. JGHandFailure (bad_motion): absent, damaged, too large, not declared, no whole frame."""
    readers = {".npz": _read_npz, ".json": _read_json, ".csv": _read_csv}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise JGHandFailure(
            "bad_motion", f"{path}: wanted one of {', '.join(readers)}, got {path.suffix or 'no suffix'}"
        )
    try:
        size = path.stat().st_size
        if size > limits.MOTION_MAX_BYTES:
            raise JGHandFailure("bad_motion", f"{path}: {size / 2**20:.0f} MiB, more than a motion has")
        joints, valid, declared = reader(path)
        joints = np.asarray(joints)
        if joints.dtype.kind not in "fiu":
            raise ValueError("the joints are no numbers")
    except OSError as error:
        raise JGHandFailure("bad_motion", f"{path}: {error.strerror or error}") from error
    except _DAMAGE as error:
        text = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise JGHandFailure("bad_motion", f"{path}: {text}") from error
    except MemoryError as error:
        raise JGHandFailure("out_of_memory", str(path)) from error
    return _checked(path, joints.astype(np.float64), valid, declared)


def write_motion(path: Path, motion: MotionFile) -> None:
    """Writes `.npz`, standard order, meters, everything declared inside; never half-written.

    JGHandFailure: cannot_write, disk_full; bad_motion for another suffix, whose kind cannot say what it holds.
    """
    if path.suffix.lower() != ".npz":
        raise JGHandFailure("bad_motion", f"{path}: wanted .npz, got {path.suffix or 'no suffix'}")
    stream = io.BytesIO()
    np.savez_compressed(
        stream,
        joints_m=np.asarray(motion.joints_m, dtype=np.float64),
        order=np.array("standard"),
        unit=np.array("m"),
        fps=np.array(motion.fps),
        handedness=np.array(motion.handedness),
        filled=np.zeros(len(motion.joints_m), bool) if motion.filled is None else motion.filled,
    )
    write_whole(path, stream.getvalue())


def _checked(path: Path, joints: np.ndarray, valid: np.ndarray | None, declared: Mapping[str, Any]) -> MotionFile:
    missing = [name for name in _DECLARED if declared.get(name) is None]
    if missing:
        raise JGHandFailure("bad_motion", f"{path} does not say its {', '.join(missing)}")
    order, unit, handedness = (str(declared[name]) for name in ("order", "unit", "handedness"))
    choices = (("order", order, _ORDERS), ("unit", unit, _METERS), ("handedness", handedness, HANDEDNESSES))
    for what, value, known in choices:
        if value not in known:
            raise JGHandFailure("bad_motion", f"{path}: {what} is {value[:40]!r}, wanted {' or '.join(known)}")
    try:
        fps = float(declared["fps"])
    except (TypeError, ValueError):
        fps = math.nan
    if not limits.FPS_MIN <= fps <= limits.FPS_MAX:
        raise JGHandFailure(
            "bad_motion", f"{path}: fps is {declared['fps']}, wanted {limits.FPS_MIN:g} to {limits.FPS_MAX:g}"
        )
    if joints.ndim != 3 or joints.shape[1:] != (len(NAMES), 3) or not len(joints):
        raise JGHandFailure("bad_motion", f"{path}: wanted frames x 21 joints x 3, got {joints.shape}")
    whole = np.array(np.isfinite(joints).all(axis=-1))
    if valid is not None:
        if valid.shape != whole.shape:
            raise JGHandFailure("bad_motion", f"{path}: 'valid' is {valid.shape}, wanted {whole.shape}")
        whole &= valid
    joints = joints[:, list(_ORDERS[order])] * _METERS[unit]
    whole = np.logical_and.reduce(whole, axis=1)
    held, notes = _held(path, joints, whole)
    filled = _filled(path, declared.get("filled"), len(joints)) | ~whole
    return MotionFile(held, fps, handedness, notes, filled if filled.any() else None)


def _filled(path: Path, said: Any, count: int) -> np.ndarray:
    """(F,) bool of what a file says of that: flags, or numbers of frames."""
    if isinstance(said, np.ndarray) and said.shape == (count,) and said.dtype.kind in "biu":
        return said.astype(bool)
    filled = np.zeros(count, dtype=bool)
    try:
        said = () if said is None else said
        numbers = [int(word) for word in said.split()] if isinstance(said, str) else list(said)
        # True is 1 to Python, and no number of a frame
        if any(type(number) is not int or not 0 <= number < count for number in numbers):
            raise ValueError("a frame that is not there")
    except (ValueError, TypeError, OverflowError) as error:
        raise JGHandFailure("bad_motion", f"{path}: 'filled' wants frames from 0 to {count - 1}") from error
    filled[numbers] = True
    return filled


def _held(path: Path, joints: np.ndarray, whole: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
    """Every frame that misses a joint repeats the last whole pose, before the first one the first."""
    if whole.all():
        return joints, ()
    if not whole.any():
        raise JGHandFailure("bad_motion", f"{path}: no frame has all 21 joints")
    count = int((~whole).sum())
    note = f"{count} of {len(whole)} frames miss joints; they hold the last whole pose."
    return joints[last_good_frames(whole)], (note,)


def _read_npz(path: Path) -> tuple[np.ndarray, np.ndarray | None, Mapping[str, Any]]:
    with zipfile.ZipFile(path) as archive:
        if sum(member.file_size for member in archive.infolist()) > limits.MOTION_MAX_BYTES:
            raise ValueError("unpacked it is larger than a motion")
        for member in archive.infolist():
            _check_header(archive, member)
    with np.load(path, allow_pickle=False) as content:
        declared = {name: content[name].item() for name in _DECLARED if name in content}
        declared.setdefault("unit", "m")
        declared["filled"] = content.get("filled")
        if declared["unit"] != "m":
            raise ValueError(f"'joints_m' means meters, and the unit is {str(declared['unit'])[:20]!r}")
        return content["joints_m"], content["valid"].astype(bool) if "valid" in content else None, declared


def _check_header(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> None:
    """Refuses an array that says to be larger than its bytes, before memory is taken for it."""
    with archive.open(member) as stream:
        version = np.lib.format.read_magic(stream)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(stream)
    if math.prod(shape) * dtype.itemsize > member.file_size:
        raise ValueError(f"{member.filename} is shorter than it says")


def _read_json(path: Path) -> tuple[np.ndarray, None, Mapping[str, Any]]:
    document = json.loads(path.read_text(encoding="utf-8"))
    if document["format"] != "jghand motion" or document["version"] != 1:
        raise ValueError(f"format {str(document['format'])[:40]!r}, version {str(document['version'])[:20]}")
    gone = [math.nan] * 3
    frames = [
        [gone if joint is None else [math.nan if x is None else x for x in joint] for joint in frame]
        for frame in document["joints"]
    ]
    return np.array(frames), None, document


def _read_csv(path: Path) -> tuple[np.ndarray, None, Mapping[str, Any]]:
    lines = path.read_text(encoding="utf-8-sig").splitlines()
    said = [line[1:].split(":", 1) for line in lines if line.startswith("#") and ":" in line]
    declared = {name.strip(): value.strip() for name, value in said}
    rows = [row for row in csv.reader(line for line in lines if not line.startswith("#")) if any(row)]
    header = [cell.strip().lower() for cell in rows[0]]
    absent = [column for column in _COLUMNS if column not in header]
    if absent:
        raise ValueError(f"no column {', '.join(absent[:3])}{' …' if len(absent) > 3 else ''}")
    places = [header.index(column) for column in _COLUMNS]
    numbers = [[float(row[place]) if row[place].strip() else math.nan for place in places] for row in rows[1:]]
    # names of columns say more than any declaration
    return np.array(numbers).reshape(-1, len(NAMES), 3), None, {**declared, "order": "standard"}
