"""CSV with a line for each joint of a frame: FreeMoCap's `RECORDING_by_frame.csv`, and from its version 2 on
`freemocap_data_by_frame.csv` and the files of single hands.

    frame, timestamp, timestamp_by_camera, model, keypoint, x, y, z, reprojection_error    to version 1.8
        mediapipe_hand, right_0000
    frame, keypoint, x, y, z, model, trajectory, reprojection_error                         version 2
        wrist, mediapipe.right_hand, 3d_xyz · hand_root, rtmpose.left_hand, rigid_3d_xyz
    frame, keypoint, x, y, z                                                                version 2, one hand
"""

from __future__ import annotations

import csv
import math
import re
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jghand_engine import limits
from jghand_engine.datasets.motions.bone_names import hands_among, side_of
from jghand_engine.datasets.motions.content import HandTrack
from jghand_engine.datasets.motions.damage import NoMotionError
from jghand_engine.datasets.motions.tables import joint_name
from jghand_engine.datasets.motions.text_lines import bounded_lines
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder

_COLUMNS = ("frame", "keypoint", "x", "y", "z")
# of the positions that version 2 gives of a joint, those that were measured
_MEASURED = "3d_xyz"
_SIDED = re.compile(r"(right|left)_(.+)")


def looks_like(header: list[str]) -> bool:
    """Whether these are the columns of such a table."""
    return set(_COLUMNS) <= {cell.strip() for cell in header}


def read_tracks(file: Path) -> tuple[tuple[HandTrack, ...], list[float]]:
    """The hands of a table, and the times of its frames, NaN where it has none. Frames that it leaves out are missing.
    ValueError."""
    # per joint frame, time, x, y, z of its lines: in this way they take hardly more memory than in the file
    lines: dict[str, array[float]] = {}
    with open(file, encoding="utf-8-sig", newline="") as stream:
        for count, (name, numbers) in enumerate(_hand_lines(csv.reader(bounded_lines(stream)), side_of(file.stem))):
            lines.setdefault(name, array("d")).extend(numbers)
            if count == limits.JOINT_LINES_UNKNOWN_MAX and not hands_among(list(lines))[0]:
                return (), []
    names = list(lines)
    hands = hands_among(names)[0]
    if not hands:
        return (), []
    tables = [np.frombuffer(numbers).reshape(-1, 5) for numbers in lines.values()]
    frames = np.unique(np.concatenate([table[:, 0] for table in tables]))
    first, count = frames[0], int(frames[-1] - frames[0]) + 1
    if count > min(limits.MOTION_FRAMES_MAX, limits.JOINT_LINES_FRAMES_MAX * len(frames)):
        raise NoMotionError(f"{len(frames)} frames, numbered {first:.0f} to {frames[-1]:.0f}")
    times = np.full(count, np.nan)
    for table in tables:
        times[(table[:, 0] - first).astype(np.int64)] = table[:, 1]
    tracks = []
    for hand in hands:
        joints = np.full((count, JOINT_COUNT, 3), np.nan)
        for joint, place in enumerate(hand.bones):
            if place is not None:
                joints[(tables[place][:, 0] - first).astype(np.int64), joint] = tables[place][:, 2:]
        part = "" if hand.handedness is None else f"{hand.handedness} hand"
        tracks.append(HandTrack(joints, hand.handedness, JointOrder.STANDARD, part))
    return tuple(tracks), times.tolist()


def _hand_lines(
    rows: Iterator[list[str]], side: Handedness | None
) -> Iterator[tuple[str, tuple[float, float, float, float, float]]]:
    """The name of every joint of a hand that was measured, and its frame, time, x, y and z. side: of a table of one
    hand."""
    header = [cell.strip() for cell in next(rows, [])]
    frame, keypoint, x, y, z = (header.index(name) for name in _COLUMNS)
    model, trajectory, time = (
        header.index(name) if name in header else None for name in ("model", "trajectory", "timestamp")
    )
    names: dict[tuple[str, str | None], str | None] = {}
    for number, row in enumerate(rows):
        if not row:
            continue
        if len(row) < len(header):
            raise ValueError(f"line {number + 2} ends after {len(row)} of {len(header)} columns")
        told = row[keypoint], None if model is None else row[model]
        if told not in names:
            if len(names) == limits.JOINT_LINES_NAMES_MAX:
                raise NoMotionError(f"more than {limits.JOINT_LINES_NAMES_MAX} names of joints")
            names[told] = _name(*told, side)
        name = names[told]
        if name is not None and (trajectory is None or row[trajectory] == _MEASURED):
            at = math.nan if time is None else _number(row[time])
            yield name, (int(row[frame]), at, _number(row[x]), _number(row[y]), _number(row[z]))


def _name(keypoint: str, model: str | None, side: Handedness | None) -> str | None:
    """A joint's name with its hand: `right_hand_wrist`; None where it is not one of a hand."""
    if model is None:
        return joint_name(keypoint if side is None else f"{side}_hand_{keypoint}")
    if not model.endswith("hand"):
        return None
    of_model, of_point = side_of(model), _SIDED.fullmatch(keypoint)
    if of_model is not None:
        return joint_name(f"{of_model}_hand_{keypoint}")
    return None if of_point is None else joint_name(f"{of_point[1]}_hand_{of_point[2]}")


def _number(cell: str) -> float:
    return float(cell) if cell else math.nan
