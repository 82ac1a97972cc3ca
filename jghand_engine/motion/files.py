"""Motions in files: `.npz`, `.json` and `.csv`, which say what they hold, and plain `.npy`, which must be told.

This module reads what stands in a file; `motion.read` makes it a motion. All formats hold positions; the joint order
in files that JGHand writes is the standard order, the unit meters. Nothing is ever unpickled.

    .npz   joints_m (F, 21, 3) · order · unit · fps · handedness · valid (F, 21) and filled (F,) optional
    .json  {"format": "jghand motion", "version": 1, "order", "unit", "fps", "handedness", "joints": [[[x, y, z], …]]}:
           frames of joints; a missing joint is null; "filled", optional, lists numbers of frames
    .csv   comment lines `# unit: m` and so on, a header `frame,wrist_x,wrist_y,…`, one line per frame; empty cells are
           missing. Without joint names in the header the columns are the 63 numbers of the declared order. A column
           called frame and one of times (`time`, `timestamp_ms`, …) may stand anywhere. `# filled: 3 4 5` is optional
    .npy   (F, 21, 3) numbers

Filled frames are those that nobody measured: whoever made the file closed a gap there.
"""

from __future__ import annotations

import csv
import itertools
import json
import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.files import writing
from jghand_engine.hand.joints import JOINT_COUNT, STANDARD_NAMES, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, from_level
from jghand_engine.hand.sequence import FPS_MAX, FPS_MIN, PoseSequence
from jghand_engine.motion.bone_names import BoneMap
from jghand_engine.motion.clocks import TIME_NAMES, plain
from jghand_engine.motion.content import (
    MOTION_MAX_BYTES,
    HandTrack,
    MotionContent,
    NoMotionError,
    check_frame_count,
    check_size,
    json_content,
)
from jghand_engine.motion.tables import is_number, number_in
from jghand_engine.npz_files import read_arrays

FORMAT, _VERSION = "jghand motion", 1
# what an archive declares beside its arrays
_DECLARED = ("order", "unit", "fps", "handedness")
_Parsed = TypeVar("_Parsed")


@dataclass(frozen=True)
class MotionFormat:
    """What the user says about a motion file; None: the file itself says it.

    order:      how the joints are listed · unit: 'm', 'cm' or 'mm'
    handedness: which hand it truly is. Keypoint packages for selfie video call a right hand "Left" (MediaPipe's old
                interface does, its new one does not): say what the hand is, not what the label says
    fps:        frames per second; replaces the file's, whose frames stay; animations with times in seconds are taken at
                this rate. Neither: 30
    check_hand: refuse joints whose bone lengths are no hand's. Turn it off for hands of odd proportions only: it is
                what catches a wrong order or unit

    For files of other programs (`motion.read`) only:

    part:            which of several skeletons, animations, captures: its name, or a part of it
    mirrored_labels: whether a detector's labels are those of a mirrored picture; None: as its interface usually has it
    bones:           names of a rig's bones by joint, where they are those of no convention
    hand_length_m:   scale the hand to this length, wrist to the middle finger's tip; a unit is not needed then
    up:              the axis that points up, "y" or "z"; replaces the file's
    """

    order: JointOrder | None = None
    unit: str | None = None
    handedness: Handedness | None = None
    fps: float | None = None
    check_hand: bool = True
    part: str | None = None
    mirrored_labels: bool | None = None
    hand_length_m: float | None = None
    bones: BoneMap | None = None
    up: str | None = None


def read_content(file: Path, suffix: str, content: Any = None) -> MotionContent:
    """What stands in a file of one of the suffixes above, whatever it is called; content: of JSON, where it was read.

    InputError, and all that `content.told_damage` tells.
    """
    declared: dict[str, Any] = {}
    valid, times = None, []
    if suffix == ".npy":
        # mapped, not read: a header that promises more than the file holds is refused before anything is allocated
        joints = _joints(np.load(file, mmap_mode="r", allow_pickle=False))
    elif suffix == ".npz":
        joints, valid = _from_npz(file, declared)
    elif suffix == ".json":
        joints = _from_json(json_content(file) if content is None else content, declared)
    else:
        check_size(file, text=True)
        joints, times = _from_csv(file, declared)
    if not len(joints):
        raise InputError(f"motion file {file}", wanted="at least one frame", came="an empty motion")
    if valid is not None:
        if valid.shape != joints.shape[:2]:
            raise InputError(f"'valid' in {file}", wanted=f"shape {joints.shape[:2]}", came=str(valid.shape))
        joints[~valid] = np.nan
    meters = _declared(f"unit of {file}", declared.get("unit"), _meters_of)
    side = _declared(f"handedness of {file}", declared.get("handedness"), Handedness)
    order = _declared(f"order of {file}", declared.get("order"), JointOrder.parse)
    fps = _declared(f"frames per second of {file}", declared.get("fps"), _fps)
    return MotionContent(
        "JGHand's own format" if order is not None and meters is not None else f"plain {suffix[1:]}",
        (HandTrack(joints, side, order),),
        meters,
        meters is not None,
        fps,
        times if fps is None else (),
        filled=_filled_frames(file, declared.get("filled"), len(joints)),
        is_plain=True,
    )


def write_motion(path: Path | str, sequence: PoseSequence) -> None:
    """Writes `.npz`, `.json` or `.csv` by the suffix: standard order, meters, everything declared inside.

    Never half-written. InputError for another suffix; `.npy` cannot say what it holds and is not written.
    """
    file = Path(path)
    check_written_suffix(file)
    with writing(file) as temporary:
        _WRITERS[file.suffix.lower()](temporary, sequence)


def check_written_suffix(file: Path) -> None:
    """InputError where `write_motion` knows no such suffix."""
    if file.suffix.lower() not in _WRITERS:
        raise InputError(f"motion file {file}", wanted=f"one of {', '.join(_WRITERS)}", came=repr(file.suffix))


def _declared(name: str, value: Any, parsed: Callable[[str], _Parsed]) -> _Parsed | None:
    """What a file declares, None for nothing. InputError calls it `name`."""
    try:
        return None if value is None else parsed(str(value))
    except InputError as error:
        raise InputError(name, wanted=error.wanted, came=error.came[:200]) from error


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
        raise InputError("frames per second", wanted=f"{FPS_MIN:g} to {FPS_MAX:g}", came=repr(text))
    return fps


def _filled_frames(file: Path, filled: Any, count: int) -> np.ndarray:
    """(count,) bool from what the file declares: the flags themselves, or the numbers of the frames. InputError."""
    if isinstance(filled, np.ndarray) and filled.shape == (count,):
        return filled.astype(bool)
    flags = np.zeros(count, dtype=bool)
    numbers = filled.split() if isinstance(filled, str) else [] if filled is None else filled
    try:
        frames = [int(number) for number in numbers if not isinstance(number, bool | float)]
        is_wrong = not isinstance(numbers, list) or len(frames) != len(numbers) or min(frames, default=0) < 0
        flags[frames] = True
    except (TypeError, ValueError, IndexError, OverflowError):
        is_wrong = True
    if is_wrong:
        wanted = f"a flag of each of the {count} frames, or their numbers"
        raise InputError(f"'filled' in {file}", wanted=wanted, came="something else")
    return flags


def _joints(array: np.ndarray) -> np.ndarray:
    """Joints (F, n, 3) as float64. Their shape is looked at before any memory is taken."""
    if array.ndim != 3 or array.shape[-1] != 3 or array.shape[1] > 2 * JOINT_COUNT:
        raise NoMotionError(f"joints of shape (frames, 21, 3) wanted, {array.shape} found")
    check_frame_count(len(array))
    if array.dtype.kind not in "fiu" or array.dtype.itemsize < 2:
        raise ValueError(f"numbers wanted, dtype {array.dtype} found")
    return np.array(array, dtype=np.float64)


# ---- numpy ----------------------------------------------------------------------------------------------------------


def _from_npz(file: Path, declared: dict[str, Any]) -> tuple[np.ndarray, np.ndarray | None]:
    """Joints, and which of them are valid."""
    arrays = read_arrays(
        file,
        (),
        f"motion file {file}",
        optional=("joints_m", "joints", "valid", "filled", *_DECLARED),
        max_bytes=MOTION_MAX_BYTES,
    )
    key = "joints_m" if "joints_m" in arrays else "joints"
    if key not in arrays:
        raise ValueError("no array 'joints_m' in it")
    declared |= {name: arrays[name].item() for name in _DECLARED if name in arrays}
    if key == "joints_m" and declared.setdefault("unit", "m") != "m":
        raise ValueError(f"'joints_m' means meters, and the unit is '{declared['unit']}': call the array 'joints'")
    declared["filled"] = arrays.get("filled")
    return _joints(arrays[key]), arrays["valid"].astype(bool) if "valid" in arrays else None


def _write_npz(file: Path, sequence: PoseSequence) -> None:
    # given a name, numpy appends .npz to what does not end so exactly
    with open(file, "wb") as stream:
        np.savez_compressed(
            stream,
            joints_m=from_level(sequence.joints_m, JointOrder.STANDARD),
            valid=_standard_valid(sequence),
            order=np.array(JointOrder.STANDARD.value),
            unit=np.array("m"),
            fps=np.array(sequence.fps),
            handedness=np.array(sequence.handedness.value),
            filled=sequence.filled,
        )


def _standard_valid(sequence: PoseSequence) -> np.ndarray:
    return np.all(np.isfinite(from_level(sequence.joints_m, JointOrder.STANDARD)), axis=-1)


# ---- JSON -----------------------------------------------------------------------------------------------------------


def _from_json(content: Any, declared: dict[str, Any]) -> np.ndarray:
    """Lists of frames of joints of x, y, z -> (F, n, 3); null joints and null coordinates become NaN."""
    frames = content
    if isinstance(content, dict):
        frames = content.get("joints")
        declared |= {name: content[name] for name in ("filled", *_DECLARED) if name in content}
        if content.get("format", FORMAT) != FORMAT:
            raise ValueError(f"its format is {str(content['format'])[:40]!r}, not {FORMAT!r}")
        if content.get("version", _VERSION) != _VERSION:
            raise ValueError(f"its version is {str(content['version'])[:40]}, and this JGHand reads {_VERSION}")
    if not isinstance(frames, list):
        raise ValueError("no list 'joints' in it")
    check_frame_count(len(frames))
    missing = [math.nan] * 3
    rows = [
        [missing if joint is None else [math.nan if x is None else x for x in joint] for joint in frame]
        for frame in frames
    ]
    return _joints(np.array(rows)) if rows else np.zeros((0, JOINT_COUNT, 3))


def _write_json(file: Path, sequence: PoseSequence) -> None:
    standard = from_level(sequence.joints_m, JointOrder.STANDARD)
    frames = [[None if math.isnan(joint[0]) else joint for joint in frame] for frame in standard.tolist()]
    filled = {"filled": np.flatnonzero(sequence.filled).tolist()} if sequence.filled.any() else {}
    document = {"format": FORMAT, "version": _VERSION, **_declarations(sequence), **filled, "joints": frames}
    file.write_text(json.dumps(document, allow_nan=False), encoding="utf-8")


def _declarations(sequence: PoseSequence) -> dict[str, str | float]:
    return {
        "order": JointOrder.STANDARD.value,
        "unit": "m",
        "fps": sequence.fps,
        "handedness": sequence.handedness.value,
    }


# ---- CSV ------------------------------------------------------------------------------------------------------------

_COLUMNS = [f"{name}_{axis}" for name in STANDARD_NAMES for axis in "xyz"]


def _from_csv(file: Path, declared: dict[str, Any]) -> tuple[np.ndarray, list[float]]:
    """Joints, and the times of the frames where there is a column of them."""
    with open(file, encoding="utf-8-sig", newline="") as stream:
        rows = (row for row in csv.reader(_without_comments(stream, declared)) if row)
        first = next(rows, [])
        header = [cell.strip().lower() for cell in first]
        clock = [place for place, name in enumerate(header) if plain(name) in TIME_NAMES][:1]
        if has_own_columns(header):
            # names say more than any declaration: the columns may stand in any order
            places = [header.index(column) for column in _COLUMNS]
            declared["order"] = JointOrder.STANDARD.value
        else:
            places = [place for place, name in enumerate(header) if plain(name) not in ("frame", *TIME_NAMES)]
            if len(places) % 3:
                raise ValueError(f"{len(places)} columns of numbers are not x, y, z of joints")
        has_header = not all(map(is_number, header))
        every = rows if has_header else itertools.chain([first] if first else [], rows)
        table = _csv_numbers(every, [*places, *clock], 1 + has_header)
    joints = table[:, : len(places)].reshape(len(table), -1, 3) if len(table) else np.zeros((0, JOINT_COUNT, 3))
    return joints, table[:, -1].tolist() if clock else []


def _without_comments(lines: Iterable[str], declared: dict[str, Any]) -> Iterator[str]:
    """The lines that are no comments; what comments declare is put into `declared`."""
    for line in lines:
        if not line.startswith("#"):
            yield line
        elif ":" in line:
            name, value = line[1:].split(":", 1)
            declared[name.strip()] = value.strip()


def has_own_columns(header: list[str]) -> bool:
    """Whether a line of CSV is a header with the names of our own columns."""
    return set(_COLUMNS) <= {cell.strip().lower() for cell in header}


def _csv_numbers(rows: Iterable[list[str]], columns: list[int], first_line: int) -> np.ndarray:
    """(F, columns) of some columns, NaN for empty cells."""
    table = []
    for number, row in enumerate(rows, first_line):
        if len(row) <= max(columns):
            raise ValueError(f"row {number} ends after {len(row)} of {max(columns) + 1} columns")
        check_frame_count(len(table) + 1)
        table.append(np.array([_cell(row[place], number, place) for place in columns]))
    return np.array(table).reshape(len(table), len(columns))


def _cell(cell: str, number: int, place: int) -> float:
    try:
        return number_in(cell)
    except ValueError as error:
        raise ValueError(f"row {number}, column {place + 1}: {cell.strip()[:30]!r} is no number") from error


def _write_csv(file: Path, sequence: PoseSequence) -> None:
    standard = from_level(sequence.joints_m, JointOrder.STANDARD).reshape(len(sequence), -1)
    with open(file, "w", encoding="utf-8", newline="") as stream:
        stream.write(f"# format: {FORMAT} {_VERSION}\n")
        stream.writelines(f"# {name}: {value}\n" for name, value in _declarations(sequence).items())
        if sequence.filled.any():
            stream.write(f"# filled: {' '.join(map(str, np.flatnonzero(sequence.filled)))}\n")
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["frame", *_COLUMNS])
        for number, row in enumerate(standard.tolist()):
            writer.writerow([number, *("" if math.isnan(x) else repr(x) for x in row)])


_WRITERS: dict[str, Callable[[Path, PoseSequence], None]] = {
    ".npz": _write_npz,
    ".json": _write_json,
    ".csv": _write_csv,
}
