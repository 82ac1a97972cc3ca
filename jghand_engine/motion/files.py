"""Motions in files: `.npz`, `.json` and `.csv`, which say what they hold, and plain `.npy`, which must be found.

This module reads what stands in a file and writes; `motion.read` makes it a motion, `motion.tables` reads CSV. All
formats hold positions; the joint order in files that JGHand writes is the standard order, the unit meters. Nothing is
ever unpickled.

    .npz   joints_m (F, 21, 3) · order · unit · fps · handedness · valid (F, 21), filled (F,) and forearm (F, 4)
           optional: quaternions w, x, y, z, see `HandPose`
    .json  {"format": "jghand motion", "version": 1, "order", "unit", "fps", "handedness", "joints": [[[x, y, z], …]]}:
           frames of joints; a missing joint is null; "filled", optional, lists numbers of frames, "forearm" quaternions
    .csv   comment lines `# unit: m` and so on, a header `frame,wrist_x,wrist_y,…`, one line per frame; empty cells are
           missing. Without joint names in the header the columns are the 63 numbers of the declared order. A column
           called frame and one of times (`time`, `timestamp_ms`, …) may stand anywhere. `# filled: 3 4 5` is optional,
           and so are the columns `forearm_w,forearm_x,forearm_y,forearm_z` beside joints that are named
    .npy   (F, 21, 3) numbers

Filled frames are those that nobody measured: whoever made the file closed a gap there.
"""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib.format import MAGIC_PREFIX

from jghand_engine.errors import InputError
from jghand_engine.files import writing
from jghand_engine.hand.joints import JOINT_COUNT, STANDARD_NAMES, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, from_level
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN, PoseSequence
from jghand_engine.motion.content import (
    MOTION_MAX_BYTES,
    HandTrack,
    MotionContent,
    MotionFormat,
    NoMotionError,
    Reader,
    Source,
    check_frame_count,
)
from jghand_engine.npz_files import read_arrays

FORMAT, _VERSION = "jghand motion", 1
# what a file declares beside its joints
_DECLARED = ("order", "unit", "fps", "handedness", "filled", "forearm")
# the columns of a table that say how the forearm is turned
FOREARM_COLUMNS = tuple(f"forearm_{axis}" for axis in "wxyz")


def own_content(path: Path, kind: str, joints: np.ndarray, declared: Mapping[str, Any]) -> MotionContent:
    """Of joints (F, n, 3) and what a file declares beside them. InputError for declarations that are none.

    kind: what the file is where it does not declare order and unit
    """
    if not len(joints):
        raise InputError(f"motion file {path}", wanted="at least one frame", came="an empty motion")
    found: dict[str, Any] = {}
    for name, parsed in _PARSED.items():
        try:
            found[name] = None if declared.get(name) is None else parsed(str(declared[name]))
        except InputError as error:
            raise InputError(f"{name} of {path}", wanted=error.wanted, came=error.came[:200]) from error
    filled = _filled_frames(path, declared.get("filled"), len(joints))
    forearm = None if declared.get("forearm") is None else np.array(declared["forearm"], np.float64)
    if forearm is not None and (forearm.shape != (len(joints), 4) or joints.shape[1] != JOINT_COUNT):
        wanted = f"a quaternion w, x, y, z for each of the {len(joints)} frames of one hand"
        raise InputError(f"'forearm' in {path}", wanted=wanted, came=f"shape {forearm.shape}")
    kind = kind if found["order"] is None or found["unit"] is None else "JGHand's own format"
    track = HandTrack(joints, found["handedness"], found["order"])
    return MotionContent(kind, (track,), found["unit"], fps=found["fps"], filled=filled, forearm=forearm, is_plain=True)


def checked_joints(array: np.ndarray) -> np.ndarray:
    """Joints (F, n, 3) as float64. Their shape is looked at before any memory is taken."""
    if array.ndim != 3 or array.shape[-1] != 3 or array.shape[1] > 2 * JOINT_COUNT:
        raise NoMotionError(f"joints of shape (frames, 21, 3) wanted, {array.shape} found")
    check_frame_count(len(array))
    if array.dtype.kind not in "fiu" or array.dtype.itemsize < 2:
        raise ValueError(f"numbers wanted, dtype {array.dtype} found")
    return np.array(array, dtype=np.float64)


def _meters_of(unit: str) -> float:
    if unit not in METERS_PER_UNIT:
        raise InputError("unit", wanted=" or ".join(METERS_PER_UNIT), came=repr(unit))
    return METERS_PER_UNIT[unit]


def _fps(text: str) -> float:
    try:
        fps = float(text)
    except ValueError:
        fps = math.nan
    if not FPS_MIN <= fps <= FPS_MAX:
        raise InputError("fps", wanted=f"{FPS_MIN:g} to {FPS_MAX:g}", came=repr(text))
    return fps


def _filled_frames(path: Path, filled: Any, count: int) -> np.ndarray:
    """(count,) bool from what the file declares: the flags themselves, or the numbers of the frames."""
    if isinstance(filled, np.ndarray) and filled.shape == (count,):
        return filled.astype(bool)
    frames = np.array([int(number) for number in filled.split()] if isinstance(filled, str) else filled)
    if filled is None or not frames.size:
        return np.zeros(count, dtype=bool)
    if frames.ndim != 1 or frames.dtype.kind != "i" or not 0 <= frames.min() <= frames.max() < count:
        wanted = f"a flag of each of the {count} frames, or their numbers"
        raise InputError(f"'filled' in {path}", wanted=wanted, came="something else")
    return np.isin(np.arange(count), frames)


_PARSED: dict[str, Callable[[str], Any]] = {
    "order": JointOrder.parse,
    "unit": _meters_of,
    "handedness": Handedness,
    "fps": _fps,
}


# ---- numpy ----------------------------------------------------------------------------------------------------------


def _read_array(source: Source, _wanted: MotionFormat) -> MotionContent:
    # mapped, not read: a header that promises more than the file holds is refused before anything is allocated
    return own_content(
        source.path, "plain npy", checked_joints(np.load(source.path, mmap_mode="r", allow_pickle=False)), {}
    )


def _read_archive(source: Source, _wanted: MotionFormat) -> MotionContent:
    names = ("joints_m", "joints", "valid", *_DECLARED)
    arrays = read_arrays(source.path, (), f"motion file {source.path}", optional=names, max_bytes=MOTION_MAX_BYTES)
    key = "joints_m" if "joints_m" in arrays else "joints"
    if key not in arrays:
        raise ValueError("no array 'joints_m' in it")
    declared = {name: arrays[name].item() for name in _DECLARED if name in arrays and not arrays[name].ndim}
    if key == "joints_m" and declared.setdefault("unit", "m") != "m":
        raise ValueError(f"'joints_m' means meters, and the unit is '{declared['unit']}': call the array 'joints'")
    joints = checked_joints(arrays[key])
    valid = arrays.get("valid", np.ones(joints.shape[:2]))
    if valid.shape != joints.shape[:2]:
        raise ValueError(f"'valid' of shape {joints.shape[:2]} wanted, {valid.shape} found")
    joints[~valid.astype(bool)] = np.nan
    return own_content(
        source.path, "plain npz", joints, declared | {name: arrays.get(name) for name in ("filled", "forearm")}
    )


# ---- JSON -----------------------------------------------------------------------------------------------------------


def _is_object(source: Source) -> bool:
    """One pose of a headset, of points {"x": …}, is none of our own files."""
    joints = source.document.get("joints") if isinstance(source.document, dict) else None
    return isinstance(joints, list) and not (joints and isinstance(joints[0], Mapping))


def _is_list(source: Source) -> bool:
    """Whether a frame that says anything is joints alone, [[x, y, z], null, …]."""
    first = next((frame for frame in source.frames if frame), None) if isinstance(source.document, list) else None
    return isinstance(first, list) and (first[0] is None or isinstance(first[0], list))


def _read_object(source: Source, _wanted: MotionFormat) -> MotionContent:
    document = source.document
    if document.get("format", FORMAT) != FORMAT:
        raise ValueError(f"its format is {str(document['format'])[:40]!r}, not {FORMAT!r}")
    if document.get("version", _VERSION) != _VERSION:
        raise ValueError(f"its version is {str(document['version'])[:40]}, and this JGHand reads {_VERSION}")
    return own_content(
        source.path, "plain json", _listed(document["joints"]), {name: document.get(name) for name in _DECLARED}
    )


def _listed(frames: list[Any]) -> np.ndarray:
    """Lists of frames of joints of x, y, z -> (F, n, 3); null joints and null coordinates become NaN."""
    check_frame_count(len(frames))
    missing = [math.nan] * 3
    rows = [
        [missing if joint is None else [math.nan if x is None else x for x in joint] for joint in frame]
        for frame in frames
    ]
    return checked_joints(np.array(rows)) if rows else np.zeros((0, JOINT_COUNT, 3))


ARRAY = Reader((".npy",), lambda source: source.head.startswith(MAGIC_PREFIX), _read_array)
ARCHIVE = Reader((".npz",), lambda source: source.head.startswith(b"PK\x03\x04"), _read_archive)
OBJECT = Reader((".json",), _is_object, _read_object)
LISTS = Reader(
    (".json",), _is_list, lambda source, _wanted: own_content(source.path, "plain json", _listed(source.document), {})
)  # fmt: skip


# ---- writing --------------------------------------------------------------------------------------------------------


def write_motion(path: Path | str, sequence: PoseSequence) -> None:
    """Writes `.npz`, `.json` or `.csv` by the suffix: standard order, meters, everything declared inside.

    Never half-written. InputError for another suffix; `.npy` cannot say what it holds and is not written.
    """
    file = Path(path)
    check_written_suffix(file)
    with writing(file) as temporary:
        _WRITERS[file.suffix.lower()](temporary, sequence, from_level(sequence.joints_m, JointOrder.STANDARD))


def check_written_suffix(file: Path) -> None:
    """InputError where `write_motion` knows no such suffix."""
    if file.suffix.lower() not in _WRITERS:
        raise InputError(f"motion file {file}", wanted=f"one of {', '.join(_WRITERS)}", came=repr(file.suffix))


def _declarations(sequence: PoseSequence) -> dict[str, str | float]:
    return {
        "order": JointOrder.STANDARD.value,
        "unit": "m",
        "fps": sequence.fps,
        "handedness": sequence.handedness.value,
    }


def _write_npz(file: Path, sequence: PoseSequence, joints_m: np.ndarray) -> None:
    arrays: dict[str, Any] = {
        "joints_m": joints_m,
        "valid": np.isfinite(joints_m).all(axis=-1),
        "filled": sequence.filled,
    }
    if sequence.forearm is not None:
        arrays["forearm"] = sequence.forearm
    declared: dict[str, Any] = {name: np.array(one) for name, one in _declarations(sequence).items()}
    # given a name, numpy appends .npz to what does not end so exactly
    with open(file, "wb") as stream:
        np.savez_compressed(stream, **arrays, **declared)


def _write_json(file: Path, sequence: PoseSequence, joints_m: np.ndarray) -> None:
    frames = [[None if math.isnan(joint[0]) else joint for joint in frame] for frame in joints_m.tolist()]
    filled = {"filled": np.flatnonzero(sequence.filled).tolist()} if sequence.filled.any() else {}
    forearm = {} if sequence.forearm is None else {"forearm": sequence.forearm.tolist()}
    document = {"format": FORMAT, "version": _VERSION, **_declarations(sequence), **filled, **forearm, "joints": frames}
    file.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _write_csv(file: Path, sequence: PoseSequence, joints_m: np.ndarray) -> None:
    names, numbers = (
        [f"{name}_{axis}" for name in STANDARD_NAMES for axis in "xyz"],
        joints_m.reshape(len(sequence), -1),
    )
    if sequence.forearm is not None:
        names, numbers = [*names, *FOREARM_COLUMNS], np.hstack([numbers, sequence.forearm])
    with open(file, "w", encoding="utf-8", newline="") as stream:
        stream.write(f"# format: {FORMAT} {_VERSION}\n")
        stream.writelines(f"# {name}: {value}\n" for name, value in _declarations(sequence).items())
        if sequence.filled.any():
            stream.write(f"# filled: {' '.join(map(str, np.flatnonzero(sequence.filled)))}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["frame", *names])
        for number, row in enumerate(numbers.tolist()):
            writer.writerow([number, *("" if math.isnan(x) else repr(x) for x in row)])


_WRITERS: dict[str, Callable[[Path, PoseSequence, np.ndarray], None]] = {
    ".npz": _write_npz,
    ".json": _write_json,
    ".csv": _write_csv,
}
