"""What FreeMoCap leaves of a recording: hands as .npy and .csv, with the landmarks of MediaPipe or RTMPose.

    output_data/…right_hand_3d_xyz.npy     (F, 21, 3); the name says the hand
    output_data/…right_hand_3d_xyz.csv     columns right_hand_wrist_x, …; from 1.2 to 1.8 right_hand_0000_x, …; from 2
                                           on a line for each joint
    output_data/…skeleton_3d.npy           (F, 75 or more, 3): 33 points of MediaPipe's body, right hand, left hand,
                                           face; early ones of version 2 have four points more in the body
    NAME_by_trajectory.csv                 those columns and others, with times
    NAME_by_frame.csv, freemocap_data_by_frame.csv    a line for each joint
    saved_data/npy/right_hand_frame_name_xyz.npy      (F, 21, 3), by FreeMoCap's add-on for Blender
    a recording's folder, or one of these             both hands: of files of hands where there are any, else of a table

Tables with a line for each joint have the columns frame, keypoint, x, y, z. Those of a whole recording have a model:

    to version 1.8    timestamp · mediapipe_hand, right_0000
    version 2         trajectory · mediapipe.right_hand, wrist, 3d_xyz · rtmpose.left_hand, hand_root, rigid_3d_xyz

The unit, millimeters but for the add-on's files, is that of the hand's size. Rates are not in them, but where there are
times.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.lib.format import MAGIC_PREFIX

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion import tables
from jghand_engine.motion.bone_names import hands_among, side_of
from jghand_engine.motion.content import (
    HandTrack,
    MotionContent,
    MotionFormat,
    NoMotionError,
    Reader,
    Source,
    check_frame_count,
    check_size,
)
from jghand_engine.motion.files import checked_joints

_HAND = re.compile(r"(right|left)_hand(_3d_xyz|_(right|left)_hand|_frame_name_xyz)$", re.IGNORECASE)
_BODY = re.compile(r"(skeleton_3d|skel_3d_body_hands_face)$", re.IGNORECASE)
# columns of a table with a line for each joint, and one that other tables of a whole recording have
_LINE_COLUMNS, _CAMERA_TIMES = {"frame", "keypoint", "x", "y", "z"}, "timestamp_by_camera"
# of the positions that version 2 gives of a joint, those that were measured
_MEASURED = "3d_xyz"
# points of a whole body: those of the body before the hands, and behind them those of a face: none, its outline,
# MediaPipe's mesh without and with irises
_BODY_POINTS, _FACE_POINTS = 33, (0, 136, 468, 478)
# points that early ones of version 2 add to a body: centers of head, neck, trunk and hips
_CENTERS = 4
# where hands are, below the folder that is named, and where all of a recording is in one table
_FOLDERS = (".", "output_data", "npy", "csv", "saved_data/npy")
_TABLES = ("*_by_trajectory.csv", "*_by_frame.csv", "output_data/*_by_frame.csv")


def _recognizes(source: Source) -> bool:
    if source.path.is_dir():
        return bool(_files_of(source.path))
    if source.head.startswith(MAGIC_PREFIX):
        return bool(_HAND.search(source.path.stem) or _BODY.search(source.path.stem))
    if source.document is not None or b"\x00" in source.head:
        return False
    header = tables.header_of(source.path)
    is_ours = set(header) >= _LINE_COLUMNS or _CAMERA_TIMES in header or _HAND.search(source.path.stem)
    return bool(is_ours) and _names_points(header)


def _names_points(header: list[str]) -> bool:
    """Whether these are the columns of a table with a hand, or with a line for each joint."""
    return set(header) >= _LINE_COLUMNS or bool(tables.named_hands(header)[0])


def _files_of(folder: Path) -> list[Path]:
    """The files to read of a recording's folder, or of one in it: those of hands, .npy where there are both; else the
    first table."""
    for place in _FOLDERS:
        for suffix in (".npy", ".csv"):
            files = sorted(file for file in (folder / place).glob(f"*{suffix}") if _HAND.search(file.stem))
            if files:
                return files
    found = (file for pattern in _TABLES for file in sorted(folder.glob(pattern)))
    return next(([file] for file in found if _names_points(tables.header_of(file))), [])


def _read(source: Source, wanted: MotionFormat) -> MotionContent:
    files = _files_of(source.path) if source.path.is_dir() else [source.path]
    tracks = [(track, file) for file in files for track in _tracks(file, wanted)]
    parts = [track.part for track, _ in tracks]
    # those of two trackers
    named = [
        track if parts.count(track.part) == 1 else replace(track, part=f"{track.part}, {file.stem}")
        for track, file in tracks
    ]
    return MotionContent("FreeMoCap", tuple(named), up="z", files=tuple(files))


def _tracks(file: Path, wanted: MotionFormat) -> list[HandTrack]:
    with open(file, "rb") as stream:
        is_array = stream.read(len(MAGIC_PREFIX)) == MAGIC_PREFIX
    if is_array:
        return _of_array(file)
    if set(tables.header_of(file)) >= _LINE_COLUMNS:
        return _of_lines(file)
    content = tables.read(Source(file), wanted)
    return [replace(track, times=content.times) for track in content.tracks]


def _of_array(file: Path) -> list[HandTrack]:
    # mapped: of a whole body only the hands are read
    points = np.load(file, mmap_mode="r", allow_pickle=False)
    if _HAND.search(file.stem):
        return [_track(points, side_of(file.stem))]
    if "rtmpose" in file.stem.casefold():
        raise NoMotionError(
            f"{file.name} does not say which of its points are a hand: name the file of a hand beside it"
        )
    first = _BODY_POINTS
    faces = points.shape[1] - first - 2 * JOINT_COUNT
    if faces < 0:
        raise NoMotionError(f"{points.shape[1]} points, which is a body without hands")
    if faces - _CENTERS in _FACE_POINTS:
        first += _CENTERS
    places = {Handedness.RIGHT: first, Handedness.LEFT: first + JOINT_COUNT}
    return [_track(points[:, place : place + JOINT_COUNT], side) for side, place in places.items()]


def _track(points: np.ndarray, side: Handedness | None) -> HandTrack:
    return HandTrack(checked_joints(points), side, JointOrder.STANDARD, "" if side is None else f"{side} hand")


# ---- tables with a line for each joint -------------------------------------------------------------------------------


def _of_lines(file: Path) -> list[HandTrack]:
    """The hands of such a table. Frames that it leaves out are missing."""
    check_size(file, text=True)
    side = side_of(file.stem)
    # by model and joint: number of the frame, time, x, y, z
    models: dict[str, dict[str, list[tuple[float, ...]]]] = {}
    with open(file, encoding="utf-8-sig", newline="") as stream:
        rows = tables.rows_of(stream, {})
        header = [cell.strip() for cell in next(rows)]
        at_keypoint, at_model = header.index("keypoint"), header.index("model") if "model" in header else None
        for cells in rows:
            if len(cells) < len(header):
                raise ValueError(f"a line of {len(cells)} cells, of {len(header)}")
            of_model = "" if at_model is None else cells[at_model].strip()
            name = _name(cells[at_keypoint].strip(), None if at_model is None else of_model, side)
            # most lines are of a body and a face
            row = dict(zip(header, map(str.strip, cells), strict=False)) if name else {}
            if name and row.get("trajectory", _MEASURED) == _MEASURED:
                numbers = (float(row["frame"]), _time(row), *(tables.number_in(row[axis]) for axis in "xyz"))
                models.setdefault(of_model, {}).setdefault(name, []).append(numbers)
    found = [
        (hand.handedness, model, [list(joints.values())[place] if place is not None else [] for place in hand.bones])
        for model, joints in models.items()
        for hand in hands_among(list(joints))[0]
    ]
    if not found:
        raise NoMotionError(f"{file.name} has no joints of a hand")
    sides = [side for side, _, _ in found]
    tracks = []
    for side, model, lines in found:
        joints, times = _frames(lines)
        names = ["" if side is None else f"{side} hand", "" if sides.count(side) == 1 else model]
        part = ", ".join(name for name in names if name)
        tracks.append(HandTrack(joints, side, JointOrder.STANDARD, part, times=times))
    return tracks


def _frames(lines: list[list[tuple[float, ...]]]) -> tuple[np.ndarray, list[float]]:
    numbers = [int(line[0]) for one in lines for line in one]
    first, count = min(numbers), max(numbers) - min(numbers) + 1
    check_frame_count(count)
    joints, times = np.full((count, JOINT_COUNT, 3), math.nan), np.full(count, math.nan)
    for joint, of_joint in enumerate(lines):
        for number, time, *xyz in of_joint:
            joints[int(number) - first, joint] = xyz
            times[int(number) - first] = time
    return joints, times.tolist()


@lru_cache(maxsize=4096)
def _name(keypoint: str, model: str | None, side: Handedness | None) -> str:
    """A joint with its side, right_hand_wrist; "" for a point of a model that is no hand's. side: of a table of one."""
    if model is None:
        return tables.joint_name(keypoint if side is None else f"{side}_hand_{keypoint}")
    if not model.endswith("hand"):
        return ""
    of_model = side_of(model)
    of_point, _, point = (of_model.value, "", keypoint) if of_model is not None else keypoint.partition("_")
    return tables.joint_name(f"{of_point}_hand_{point}")


def _time(row: Mapping[str, str]) -> float:
    """NaN for what is no number, a date for example."""
    try:
        return tables.number_in(row.get("timestamp", ""))
    except ValueError:
        return math.nan


READER = Reader((".npy", ".csv"), _recognizes, _read)
