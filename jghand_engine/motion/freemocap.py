"""What FreeMoCap leaves of a recording: hands as .npy and .csv, with the landmarks of MediaPipe or RTMPose.

    output_data/…right_hand_3d_xyz.npy     (F, 21, 3), millimeters; the name says the hand
    output_data/…right_hand_3d_xyz.csv     columns right_hand_wrist_x, …; from 1.2 to 1.8 right_hand_0000_x, …; from 2
                                           on a line for each joint (`freemocap_lines`)
    output_data/…skeleton_3d.npy           (F, 75 or more, 3): 33 points of MediaPipe's body, right hand, left hand,
                                           face; older mediaPipeSkel_3d_body_hands_face.npy, NAME_frame_name_xyz.npy;
                                           early ones of version 2 have four points more in the body
    NAME_by_trajectory.csv                 those columns and others, with times
    NAME_by_frame.csv, freemocap_data_by_frame.csv    a line for each joint
    saved_data/npy/right_hand_frame_name_xyz.npy      (F, 21, 3), by FreeMoCap's add-on for Blender, in Blender's unit
    saved_data/csv/right_hand_trajectories.csv        its columns, in a remark
    saved_data/all_trajectories.csv                   those of both hands and others
    a recording's folder, or one of these             both hands: of files of hands where there are any, else of a table
Rates are not in them, but where there are times.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.lib.format import MAGIC_PREFIX

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder
from jghand_engine.motion import freemocap_lines
from jghand_engine.motion.bone_names import side_of
from jghand_engine.motion.content import HandTrack, MotionContent, NoMotionError, check_frame_count, check_size
from jghand_engine.motion.tables import header_in, named_hands, read_tracks

KIND = "FreeMoCap"
_HAND = re.compile(r"(right|left)_hand(_3d_xyz|_(right|left)_hand)$", re.IGNORECASE)
_BODY = re.compile(r"(skeleton_3d|skel_3d_body_hands_face|frame_name_xyz)$", re.IGNORECASE)
# what the add-on for Blender saves: a hand, a table of all points, and arrays whose points have no names
_SAVED_HAND = re.compile(r"^(right|left)_hand_(frame_name_xyz|trajectories)$", re.IGNORECASE)
_SAVED_TABLE = re.compile(r"^all_trajectories$", re.IGNORECASE)
_SAVED_OTHER = re.compile(r"^(all|body|face|other|center_of_mass)_frame_name_xyz$", re.IGNORECASE)
# a column that tables of a whole recording have, and nobody else's
_CAMERA_TIMES = "timestamp_by_camera"
# points of a whole body: those of the body before the hands, and behind them those of a face: none, its outline,
# MediaPipe's mesh without and with irises
_BODY_POINTS, _FACE_POINTS = 33, (0, 136, 468, 478)
# points that early ones of version 2 add to a body: centers of head, neck, trunk and hips
_CENTERS = 4
# where hands are, below the folder that is named, and where all of a recording is in one table
_FOLDERS = (".", "output_data", "npy", "csv", "saved_data/npy", "saved_data/csv")
_TABLES = (
    *("all_trajectories.csv", "saved_data/all_trajectories.csv"),
    *("freemocap_data_by_frame.csv", "output_data/freemocap_data_by_frame.csv"),
    *("*_by_trajectory.csv", "*_by_frame.csv"),
)


def is_array(file: Path) -> bool:
    """Whether the name of an array is one of FreeMoCap's."""
    return _is_hand(file) or bool(_BODY.search(file.stem))


def is_table(file: Path, header: list[str]) -> bool:
    """Whether a table that names a hand is FreeMoCap's, by a column that only it has, or by the file's name."""
    return _CAMERA_TIMES in header or _is_hand(file) or bool(_SAVED_TABLE.search(file.stem))


def files_of(folder: Path) -> list[Path]:
    """The files to read of a recording's folder, or of one in it: those of hands, .npy where there are both; else the
    first table."""
    for place in _FOLDERS:
        for suffix in (".npy", ".csv"):
            files = sorted(file for file in (folder / place).glob(f"*{suffix}") if _is_hand(file) and file.is_file())
            if files:
                return files
    tables = (file for pattern in _TABLES for file in sorted(folder.glob(pattern)) if file.is_file())
    return next(([file] for file in tables if _names_points(header_in(file))), [])


def read(files: list[Path]) -> MotionContent:
    """The hands in some files of one recording. ValueError, OSError."""
    contents = [_array(file) if _begins_as_array(file) else _table(file) for file in files]
    tracks = [(track, file) for (tracks, _), file in zip(contents, files, strict=True) for track in tracks]
    parts = [track.part for track, _ in tracks]
    # those of two trackers
    named = [
        track if parts.count(track.part) == 1 else replace(track, part=f"{track.part}, {file.stem}")
        for track, file in tracks
    ]
    return MotionContent(KIND, tuple(named), contents[0][1], up="z", files=tuple(files))


def _names_points(header: list[str]) -> bool:
    """Whether these are the columns of a table with a hand, or with a line for each joint."""
    return freemocap_lines.looks_like(header) or bool(named_hands(header)[0])


def _is_hand(file: Path) -> bool:
    return bool(_HAND.search(file.stem) or _SAVED_HAND.search(file.stem))


def _begins_as_array(file: Path) -> bool:
    with open(file, "rb") as stream:
        return stream.read(len(MAGIC_PREFIX)) == MAGIC_PREFIX


def _unit(file: Path) -> float | None:
    """Meters per unit; None for what the add-on saves, in the unit that Blender had."""
    saved = _SAVED_HAND.search(file.stem) or _SAVED_TABLE.search(file.stem)
    return None if saved else METERS_PER_UNIT["mm"]


def _table(file: Path) -> tuple[list[HandTrack], float | None]:
    """The hands of a table, and its unit."""
    check_size(file, text=True)
    header, unit = header_in(file), _unit(file)
    if freemocap_lines.looks_like(header):
        tracks = freemocap_lines.read_tracks(file)
        # somebody else may write such a table of one hand
        unit = unit if freemocap_lines.has_models(header) or _is_hand(file) else None
    else:
        named, times = read_tracks(file)
        tracks = [replace(track, times=times) for track in named]
    if not tracks:
        raise NoMotionError(f"{file.name} has no joints of a hand")
    return tracks, unit


def _array(file: Path) -> tuple[list[HandTrack], float | None]:
    """The hands of an array, and its unit."""
    if _SAVED_OTHER.search(file.stem) or ("rtmpose" in file.stem.casefold() and not _is_hand(file)):
        raise NoMotionError(
            f"{file.name} does not say which of its points are a hand: name the file of a hand beside it"
        )
    # mapped: of a whole body only the hands are read
    points = np.load(file, mmap_mode="r", allow_pickle=False)
    if points.ndim != 3 or points.shape[-1] != 3 or points.dtype.kind != "f":
        raise ValueError(f"numbers of shape {points.shape} where (frames, points, 3) were wanted")
    check_frame_count(len(points))
    if _is_hand(file):
        if points.shape[1] != JOINT_COUNT:
            raise NoMotionError(f"{points.shape[1]} points where a hand has {JOINT_COUNT}")
        return [_track(points, 0, side_of(file.stem))], _unit(file)
    first = _BODY_POINTS
    faces = points.shape[1] - first - 2 * JOINT_COUNT
    if faces < 0:
        raise NoMotionError(f"{points.shape[1]} points, which is a body without hands")
    if faces - _CENTERS in _FACE_POINTS:
        first += _CENTERS
    hands = [_track(points, first, Handedness.RIGHT), _track(points, first + JOINT_COUNT, Handedness.LEFT)]
    return hands, _unit(file)


def _track(points: np.ndarray, first: int, side: Handedness | None) -> HandTrack:
    joints = np.array(points[:, first : first + JOINT_COUNT], dtype=np.float64)
    joints[~np.isfinite(joints).all(axis=-1)] = np.nan
    return HandTrack(joints, side, JointOrder.STANDARD, "" if side is None else f"{side} hand")
