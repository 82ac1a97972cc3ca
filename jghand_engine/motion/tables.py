"""CSV with a line for each frame: our own, plain numbers, and tables whose columns are named after joints in any way,
`right_hand_wrist_x`, `INDEX_FINGER_TIP.z`."""

from __future__ import annotations

import csv
import itertools
import math
import re
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.hand.joints import STANDARD_NAMES
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.bone_names import NamedHand, hands_among
from jghand_engine.motion.clocks import TIME_NAMES, plain
from jghand_engine.motion.content import (
    HandTrack,
    MotionContent,
    MotionFormat,
    Reader,
    Source,
    check_frame_count,
    check_size,
)
from jghand_engine.motion.files import FOREARM_COLUMNS, checked_joints, own_content

# a joint's name, what parts it from its axis, the axis
_COLUMN = re.compile(r"(.+?)[._ -]+([xyz])", re.IGNORECASE)
# joints that have a number for a name, as FreeMoCap wrote them from 1.2 to 1.8: right_hand_0000
_NUMBERED = re.compile(r"((?:right|left)_hand)_00([01]\d|20)")


def joint_name(text: str) -> str:
    """The name of a joint in the header of a table; for one that is a number, in MediaPipe's order, ours."""
    match = _NUMBERED.fullmatch(text)
    return text if match is None else f"{match[1]}_{STANDARD_NAMES[int(match[2])]}"


def header_of(file: Path) -> list[str]:
    """The cells of the first line that is no comment, [] where there is none."""
    with open(file, encoding="utf-8-sig", errors="replace", newline="") as stream:
        return [cell.strip() for cell in next(rows_of(stream, {}), [])]


def rows_of(lines: Iterable[str], declared: dict[str, Any]) -> Iterator[list[str]]:
    """The cells of the lines that are neither comments nor blank; what comments declare is put into `declared`."""

    def holds_cells(line: str) -> bool:
        name, _, value = line[1:].partition(":")
        if line.startswith("#"):
            declared[name.strip()] = value.strip()
        return bool(line.strip()) and not line.startswith("#")

    return csv.reader(filter(holds_cells, lines))


def named_hands(header: list[str]) -> tuple[list[NamedHand], list[tuple[int, int, int]]]:
    """The hands among the columns of a header, and the columns of x, y, z of every name."""
    places: dict[str, dict[str, int]] = {}
    for place, cell in enumerate(header):
        match = _COLUMN.fullmatch(cell.strip('"'))
        if match is not None:
            places.setdefault(joint_name(match[1]), {})[match[2].casefold()] = place
    columns = {name: (at["x"], at["y"], at["z"]) for name, at in places.items() if len(at) == 3}
    return hands_among(list(columns))[0], list(columns.values())


def _recognizes(source: Source) -> bool:
    return source.path.is_file() and source.document is None and b"\x00" not in source.head and (
        len(header_of(source.path)) > 2
    )  # fmt: skip


def read(source: Source, _wanted: MotionFormat) -> MotionContent:
    """The hands that the columns name; where they name none, the columns are the numbers of one."""
    check_size(source.path, text=True)
    declared: dict[str, Any] = {}
    with open(source.path, encoding="utf-8-sig", newline="") as stream:
        rows = rows_of(stream, declared)
        first = next(rows, [])
        header = [cell.strip() for cell in first]
        clock = [place for place, cell in enumerate(header) if plain(cell) in TIME_NAMES][:1]
        hands, columns = named_hands(header)
        turn: list[int] = []
        if hands:
            turn = [header.index(name) for name in FOREARM_COLUMNS if name in header]
            flat = [
                at for hand in hands for bone in hand.bones for at in (columns[bone] if bone is not None else (-1,) * 3)
            ]
        else:
            flat = [place for place, cell in enumerate(header) if plain(cell) not in ("frame", *TIME_NAMES)]
            if len(flat) % 3:
                raise ValueError(f"{len(flat)} columns of numbers are not x, y, z of joints")
            if all(map(_is_number, header)):
                rows = itertools.chain([first], rows)
        places = flat + turn + clock
        table = np.array(list(_numbers(rows, places))).reshape(-1, len(places))
    joints = table[:, : len(flat)].reshape(len(table), -1, 3)
    times = table[:, -1].tolist() if clock else []
    if not hands or (hands[0].convention == "JGHand" and hands[0].handedness is None):
        known: dict[str, Any] = {"order": JointOrder.STANDARD} if hands else {}
        if turn:
            known["forearm"] = table[:, len(flat) : len(flat) + len(turn)]
        content = own_content(source.path, "plain csv", checked_joints(joints), declared | known)
        return replace(content, times=times if content.fps is None else ())
    tracks = (
        HandTrack(joints, hand.handedness, JointOrder.STANDARD, hand.part)
        for hand, joints in zip(hands, np.split(joints, len(hands), axis=1), strict=True)
    )
    return MotionContent("a table of joints", tuple(tracks), times=times)


def _numbers(rows: Iterable[list[str]], columns: list[int]) -> Iterator[np.ndarray]:
    """Numbers of some columns, NaN where the cell is empty or the column -1: a line of empty cells is a frame without a
    hand."""
    last = max(columns)
    for number, row in enumerate(rows, 1):
        check_frame_count(number)
        if len(row) <= last:
            raise ValueError(f"frame {number} ends after {len(row)} of {last + 1} columns")
        try:
            yield np.array([number_in(row[place]) if place >= 0 else math.nan for place in columns])
        except ValueError as error:
            place = next(place for place in columns if place >= 0 and not _is_number(row[place]))
            text = f"frame {number}, column {place + 1}: {row[place].strip()[:30]!r} is no number"
            raise ValueError(text) from error


def number_in(cell: str) -> float:
    """What stands in a cell, NaN where it is empty. ValueError."""
    return float(cell) if cell.strip() else math.nan


def _is_number(cell: str) -> bool:
    try:
        number_in(cell)
    except ValueError:
        return False
    return True


READER = Reader((".csv",), _recognizes, read)
