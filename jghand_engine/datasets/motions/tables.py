"""CSV whose columns are named after joints in a way that is not our own: `right_hand_wrist_x`, `INDEX_FINGER_TIP_z`."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from jghand_engine import limits
from jghand_engine.datasets.motions.bone_names import NamedHand, hands_among
from jghand_engine.datasets.motions.content import HandTrack
from jghand_engine.datasets.motions.damage import NoMotionError
from jghand_engine.datasets.motions.text_lines import bounded_lines
from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.hand.orders import JointOrder

_AXES = ("x", "y", "z")


def named_hands(header: list[str]) -> tuple[list[NamedHand], dict[str, tuple[int, int, int]], list[str]]:
    """The hands among the columns of a header, the columns of x, y, z of every name, and the names in their order."""
    places: dict[str, dict[str, int]] = {}
    for place, cell in enumerate(header):
        name, _, axis = cell.strip().strip('"').rpartition("_" if "_" in cell else ".")
        if name and axis.casefold() in _AXES:
            places.setdefault(name, {})[axis.casefold()] = place
    columns = {name: (at["x"], at["y"], at["z"]) for name, at in places.items() if len(at) == 3}
    names = list(columns)
    return hands_among(names)[0], columns, names


def read_tracks(file: Path) -> tuple[HandTrack, ...]:
    """The hands of a table, one line for each frame; none when its columns are named after no hand. ValueError."""
    with open(file, encoding="utf-8-sig", newline="") as stream:
        rows = csv.reader(line for line in bounded_lines(stream) if not line.startswith("#"))
        header = next(rows, [])
        hands, columns, names = named_hands(header)
        if not hands:
            return ()
        wanted = [[() if place is None else columns[names[place]] for place in hand.bones] for hand in hands]
        joints = np.array(list(_frames(rows, wanted)), dtype=np.float64).reshape(-1, len(hands), JOINT_COUNT, 3)
    return tuple(
        HandTrack(joints[:, number], hand.handedness, JointOrder.STANDARD, hand.part)
        for number, hand in enumerate(hands)
    )


def _frames(rows: Iterator[list[str]], wanted: list[list[tuple[int, ...]]]) -> Iterator[np.ndarray]:
    flat = [place for hand in wanted for joint in hand for place in (joint or (-1, -1, -1))]
    for number, row in enumerate(rows):
        if not any(row):
            continue
        if number >= limits.MOTION_FRAMES_MAX:
            raise NoMotionError(f"more than {limits.MOTION_FRAMES_MAX} lines")
        if len(row) <= max(flat):
            raise ValueError(f"line {number + 2} ends after {len(row)} of {max(flat) + 1} columns")
        yield np.array([_number(row[place]) if place >= 0 else math.nan for place in flat])


def _number(cell: str) -> float:
    return float(cell) if cell.strip() else math.nan
