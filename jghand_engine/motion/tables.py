"""CSV whose columns are named after joints in a way that is not our own: `right_hand_wrist_x`, `INDEX_FINGER_TIP_z`."""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, STANDARD_NAMES
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.bone_names import NamedHand, hands_among
from jghand_engine.motion.clocks import TIME_NAMES, plain
from jghand_engine.motion.content import HandTrack, MotionContent, check_frame_count, check_size

# a joint's name, what parts it from its axis, the axis
_COLUMN = re.compile(r"(.+?)[._ -]+([xyz])", re.IGNORECASE)
# joints that have a number for a name, as FreeMoCap wrote them from 1.2 to 1.8: right_hand_0000
_NUMBERED = re.compile(r"((?:right|left)_hand)_(\d{4})")


def joint_name(text: str) -> str:
    """The name of a joint in the header of a table; for one that is a number, in MediaPipe's order, ours."""
    match = _NUMBERED.fullmatch(text)
    if match is None or int(match[2]) >= JOINT_COUNT:
        return text
    return f"{match[1]}_{STANDARD_NAMES[int(match[2])]}"


def named_hands(header: list[str]) -> tuple[list[NamedHand], dict[str, tuple[int, int, int]], list[str]]:
    """The hands among the columns of a header, the columns of x, y, z of every name, and the names in their order."""
    places: dict[str, dict[str, int]] = {}
    for place, cell in enumerate(header):
        match = _COLUMN.fullmatch(cell.strip().strip('"'))
        if match is not None:
            places.setdefault(joint_name(match[1]), {})[match[2].casefold()] = place
    columns = {name: (at["x"], at["y"], at["z"]) for name, at in places.items() if len(at) == 3}
    names = list(columns)
    return hands_among(names)[0], columns, names


def cells_of(lines: Iterable[str]) -> Iterator[list[str]]:
    """The cells of a table's header, stripped, and of every line below it, without remarks and blank lines.

    The header may be a remark, as numpy's `savetxt` writes it: the last one above a line of numbers, if it names a hand
    and no remark declares anything, which those of our own tables do.
    """
    lines = iter(lines)
    remark, declares = "", False
    for line in lines:
        if line.startswith("#"):
            remark, declares = line, declares or ":" in line
        elif line.strip():
            break
    else:
        return
    below = (line for line in lines if line.strip() and not line.startswith("#"))
    rows = csv.reader(itertools.chain([line], below))
    first = next(rows)
    if remark and not declares and all(map(is_number, first)):
        header = _stripped(next(csv.reader([remark.lstrip("# ")])))
        if named_hands(header)[0]:
            yield header
    yield _stripped(first)
    yield from rows


def _stripped(cells: list[str]) -> list[str]:
    return [cell.strip() for cell in cells]


def header_in(file: Path) -> list[str]:
    """The cells of the header of a table, [] where there is no line but remarks. ValueError, OSError."""
    with open(file, encoding="utf-8-sig", errors="replace", newline="") as stream:
        return next(cells_of(stream), [])


def read(file: Path) -> MotionContent:
    """A table of no program's own."""
    tracks, times = read_tracks(file)
    return MotionContent("a table of joints", tracks, times=times)


def read_tracks(file: Path) -> tuple[tuple[HandTrack, ...], list[float]]:
    """The hands of a table, one line for each frame, and its times in whatever unit, NaN where one is missing, []
    without a column of them; no hand when its columns are named after none. ValueError."""
    check_size(file, text=True)
    with open(file, encoding="utf-8-sig", newline="") as stream:
        rows = cells_of(stream)
        header = next(rows, [])
        hands, columns, names = named_hands(header)
        if not hands:
            return (), []
        flat = [
            column
            for hand in hands
            for place in hand.bones
            for column in ((-1, -1, -1) if place is None else columns[names[place]])
        ]
        clock = [place for place, cell in enumerate(header) if plain(cell) in TIME_NAMES][:1]
        table = np.array(list(_frames(rows, flat + clock)), dtype=np.float64).reshape(-1, len(flat) + len(clock))
    joints = table[:, : len(flat)].reshape(-1, len(hands), JOINT_COUNT, 3)
    tracks = tuple(
        HandTrack(joints[:, number], hand.handedness, JointOrder.STANDARD, hand.part)
        for number, hand in enumerate(hands)
    )
    return tracks, table[:, -1].tolist() if clock else []


def _frames(rows: Iterator[list[str]], columns: list[int]) -> Iterator[np.ndarray]:
    """Numbers of some columns, NaN where the cell is empty or the column -1: a line of empty cells is a frame without a
    hand."""
    last = max(columns)
    for number, row in enumerate(rows):
        check_frame_count(number + 1)
        if len(row) <= last:
            raise ValueError(f"line {number + 2} ends after {len(row)} of {last + 1} columns")
        yield np.array([number_in(row[place]) if place >= 0 else math.nan for place in columns])


def number_in(cell: str) -> float:
    """What stands in a cell, NaN where it is empty. ValueError."""
    return float(cell) if cell.strip() else math.nan


def is_number(cell: str) -> bool:
    """Whether a number stands in a cell, or nothing."""
    try:
        number_in(cell)
    except ValueError:
        return False
    return True
