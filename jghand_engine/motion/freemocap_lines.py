"""CSV with a line for each joint of a frame: FreeMoCap's `RECORDING_by_frame.csv`, and from its version 2 on
`freemocap_data_by_frame.csv` and the files of single hands.

    frame, timestamp, timestamp_by_camera, model, keypoint, x, y, z, reprojection_error    to version 1.8
        mediapipe_hand, right_0000
    frame, keypoint, x, y, z, model, trajectory, reprojection_error                         version 2
        wrist, mediapipe.right_hand, 3d_xyz · hand_root, rtmpose.left_hand, rigid_3d_xyz
    frame, keypoint, x, y, z                                                                version 2, one hand
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.sequence import MOTION_FRAMES_MAX
from jghand_engine.motion.bone_names import BONES_RECOGNIZED_MIN, hands_among, side_of
from jghand_engine.motion.content import HandTrack, NoMotionError
from jghand_engine.motion.tables import cells_of, joint_name, number_in

# names of points in a table with a line for each: body, hands and face have 553
NAMES_MAX = 2000
# frames for each line of a hand, of which a whole one has 21: FreeMoCap leaves none out
FRAMES_PER_LINE_MAX = 2
# characters of a frame's number: 64 bits have 20, a sign and a fraction
FRAME_NUMBER_CHARACTERS_MAX = 24
_COLUMNS = ("frame", "keypoint", "x", "y", "z")
# of the positions that version 2 gives of a joint, those that were measured
_MEASURED = "3d_xyz"
_SIDED = re.compile(r"(right|left)_(.+)")


class _Point(NamedTuple):
    """A joint. model: of the hand, "" in a table of one · name: with its side: right_hand_wrist"""

    model: str
    name: str


@dataclass(frozen=True)
class _Hand:
    """A hand among the points. joints: the place of each, standard order · model: which it is of"""

    side: Handedness | None
    joints: dict[_Point, int]
    model: str


def looks_like(header: list[str]) -> bool:
    """Whether these are the columns of such a table."""
    return set(_COLUMNS) <= set(header)


def has_models(header: list[str]) -> bool:
    """Whether it is one of a whole recording."""
    return "model" in header


def read_tracks(file: Path) -> list[HandTrack]:
    """The hands of a table. Frames that it leaves out are missing. ValueError."""
    lines = list(_hand_lines(file))
    hands = _hands(list(dict.fromkeys(point for point, _, _ in lines)))
    numbers = [frame for _, frame, _ in lines]
    first, last = min(numbers, default=0), max(numbers, default=0)
    count = last - first + 1
    if count > MOTION_FRAMES_MAX or count > FRAMES_PER_LINE_MAX * len(lines):
        raise NoMotionError(f"frames numbered {first} to {last}, most of which are not there: number them one by one")
    joints = np.full((len(hands), count, JOINT_COUNT, 3), math.nan)
    is_told = np.zeros(joints.shape[:3], bool)
    times = np.full((len(hands), count), math.nan)
    places = {point: (number, joint) for number, hand in enumerate(hands) for point, joint in hand.joints.items()}
    for point, frame, (time, *xyz) in lines:
        if point in places:
            (number, joint), row = places[point], frame - first
            if is_told[number, row, joint]:
                raise NoMotionError(f"frame {frame} has two lines of {point.name}, as of two recordings")
            is_told[number, row, joint] = True
            joints[number, row, joint] = [number_in(cell) for cell in xyz]
            times[number, row] = _time(time)
    sides = [hand.side for hand in hands]
    return [
        HandTrack(
            joints[number], hand.side, JointOrder.STANDARD, _part(hand, alone=sides.count(hand.side) == 1),
            times=times[number].tolist(),
        )
        for number, hand in enumerate(hands)
    ]  # fmt: skip


def _hands(points: list[_Point]) -> list[_Hand]:
    """Those whose joints are there."""
    of_models: dict[str, list[_Point]] = {}
    for point in points:
        of_models.setdefault(point.model, []).append(point)
    found = []
    for model, of_model in of_models.items():
        # looking takes milliseconds, and a file may name thousands
        if len(of_model) < BONES_RECOGNIZED_MIN:
            continue
        for hand in hands_among([point.name for point in of_model])[0]:
            joints = {of_model[place]: joint for joint, place in enumerate(hand.bones) if place is not None}
            found.append(_Hand(hand.handedness, joints, model))
    return found


def _part(hand: _Hand, *, alone: bool) -> str:
    """`right hand`, with the model where there are several."""
    side = "" if hand.side is None else f"{hand.side} hand"
    return side if alone else f"{side}, {hand.model}".strip(", ")


def _hand_lines(file: Path) -> Iterator[tuple[_Point, int, tuple[str, str, str, str]]]:
    """The lines of hands that were measured: joint, frame, and the cells of time, x, y and z."""
    side = side_of(file.stem)
    points: dict[tuple[str, str | None], _Point | None] = {}
    with open(file, encoding="utf-8-sig", newline="") as stream:
        rows = cells_of(stream)
        header = next(rows, [])
        frame, keypoint, x, y, z = (header.index(name) for name in _COLUMNS)
        model, trajectory, time = (
            header.index(name) if name in header else None for name in ("model", "trajectory", "timestamp")
        )
        for number, row in enumerate(rows):
            if len(row) < len(header):
                raise ValueError(f"row {number + 1} ends after {len(row)} of {len(header)} columns")
            told = row[keypoint], None if model is None else row[model]
            if told not in points:
                if len(points) == NAMES_MAX:
                    raise NoMotionError(f"more than {NAMES_MAX} names of joints")
                points[told] = _point(told[0].strip(), None if told[1] is None else told[1].strip(), side)
            point = points[told]
            if point is not None and (trajectory is None or row[trajectory].strip() == _MEASURED):
                yield point, _frame(row[frame]), ("" if time is None else row[time], row[x], row[y], row[z])


def _point(keypoint: str, model: str | None, side: Handedness | None) -> _Point | None:
    """A joint; None for a point of a model that is no hand's. side: of a table without models."""
    if model is None:
        return _Point("", joint_name(keypoint if side is None else f"{side}_hand_{keypoint}"))
    if not model.endswith("hand"):
        return None
    of_model, of_point = side_of(model), _SIDED.fullmatch(keypoint)
    if of_model is not None:
        return _Point(model, joint_name(f"{of_model}_hand_{keypoint}"))
    return None if of_point is None else _Point(model, joint_name(f"{of_point[1]}_hand_{of_point[2]}"))


def _frame(cell: str) -> int:
    if len(cell) > FRAME_NUMBER_CHARACTERS_MAX:
        raise ValueError(f"a frame called {cell[:20]}…")
    try:
        return int(cell)
    except ValueError:
        # what has been through a table of real numbers: 12.0
        number = float(cell)
        if not number.is_integer():
            raise
        return int(number)


def _time(cell: str) -> float:
    """NaN for what is no number, a date for example."""
    try:
        return number_in(cell)
    except ValueError:
        return math.nan
