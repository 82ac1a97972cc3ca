"""What FreeMoCap leaves of a recording: hands as .npy and .csv, with the landmarks of MediaPipe or RTMPose.

    output_data/…right_hand_3d_xyz.npy     (F, 21, 3), millimetres; the name says the hand
    output_data/…right_hand_3d_xyz.csv     columns right_hand_wrist_x, …; from 1.2 to 1.8 right_hand_0000_x, …; from 2
                                           on a line for each joint (`joint_lines`)
    output_data/…skeleton_3d.npy           (F, 75 or more, 3): 33 points of MediaPipe's body, right hand, left hand,
                                           face; older mediaPipeSkel_3d_body_hands_face.npy, NAME_frame_name_xyz.npy
    NAME_by_trajectory.csv                 those columns and others, with times
    NAME_by_frame.csv, freemocap_data_by_frame.csv    a line for each joint
    saved_data/npy/right_hand_frame_name_xyz.npy      (F, 21, 3), by FreeMoCap's add-on for Blender, in Blender's unit
    saved_data/csv/right_hand_trajectories.csv        its columns, in a remark; all_trajectories.csv has both hands
    a recording's folder, or one of these             both hands of its output_data, or else of its saved_data
Rates are not in them, but where there are times.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from jghand_engine import limits
from jghand_engine.datasets.motions import joint_lines
from jghand_engine.datasets.motions.bone_names import side_of
from jghand_engine.datasets.motions.content import HandTrack, MotionContent
from jghand_engine.datasets.motions.damage import NoMotionError
from jghand_engine.datasets.motions.tables import header_of, read_tracks
from jghand_engine.datasets.motions.text_lines import bounded_lines
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METRES_PER_UNIT, JointOrder

KIND = "FreeMoCap"
# what the add-on for Blender saves
_SAVED_HAND = re.compile(r"^(right|left)_hand_(frame_name_xyz|trajectories)$", re.IGNORECASE)
_SAVED_ALL = re.compile(r"^all_trajectories$", re.IGNORECASE)
# its arrays of more than a hand, whose points stand in a file of their own
_SAVED_OTHER = re.compile(r"^(all|body|face)_frame_name_xyz$", re.IGNORECASE)
_HAND = re.compile(r"(right|left)_hand(_3d_xyz|_(right|left)_hand)$", re.IGNORECASE)
_BODY = re.compile(r"(skeleton_3d|skel_3d_body_hands_face|frame_name_xyz)$", re.IGNORECASE)
_TABLE = re.compile(r"_by_(frame|trajectory)$", re.IGNORECASE)
# where hands are, below the folder that is named
_FOLDERS = (".", "output_data", "npy", "csv", "saved_data/npy", "saved_data/csv")


def looks_like(file: Path) -> bool:
    """Whether the name of an .npy or .csv file is one of FreeMoCap's."""
    return any(name.search(file.stem) for name in (_SAVED_HAND, _SAVED_ALL, _HAND, _BODY, _TABLE))


def hand_files(folder: Path) -> list[Path]:
    """The files of hands in a recording's folder or below it; .npy where there are both."""
    for place in _FOLDERS:
        for suffix in (".npy", ".csv"):
            files = sorted(file for file in (folder / place).glob(f"*{suffix}") if _is_hand(file))
            if files:
                return files
    return []


def read(files: list[Path]) -> MotionContent:
    """The hands in some files of one recording. ValueError, OSError."""
    tracks: list[HandTrack] = []
    times: list[float] = []
    for file in files:
        if file.suffix.lower() == ".npy":
            tracks += _array(file)
        else:
            hands, times = _table(file)
            tracks += hands
    saved = any(name.search(file.stem) for name in (_SAVED_HAND, _SAVED_ALL) for file in files)
    unit = None if saved else METRES_PER_UNIT["mm"]
    return MotionContent(KIND, tuple(tracks), unit, times=times, up="z", files=tuple(files))


def _is_hand(file: Path) -> bool:
    return bool(_HAND.search(file.stem) or _SAVED_HAND.search(file.stem))


def _table(file: Path) -> tuple[tuple[HandTrack, ...], list[float]]:
    """The hands of a table, and the times of its frames, [] where they have none."""
    with open(file, encoding="utf-8-sig", newline="") as stream:
        is_lines = joint_lines.looks_like(header_of(bounded_lines(stream)))
    tracks, times = (joint_lines.read_tracks if is_lines else read_tracks)(file)
    if not tracks:
        raise NoMotionError(f"{file.name} has no joints of a hand")
    return tracks, times


def _array(file: Path) -> list[HandTrack]:
    if _SAVED_OTHER.search(file.stem):
        raise NoMotionError(f"{file.name} does not say which of its points are a hand: right_hand_frame_name_xyz.npy, "
                            "beside it, is one")  # fmt: skip
    # mapped: of a whole body only the hands are read
    points = np.load(file, mmap_mode="r", allow_pickle=False)
    if points.ndim != 3 or points.shape[-1] != 3 or points.dtype.kind != "f":
        raise ValueError(f"numbers of shape {points.shape} where (frames, points, 3) were wanted")
    if len(points) > limits.MOTION_FRAMES_MAX:
        raise NoMotionError(f"more than {limits.MOTION_FRAMES_MAX} frames")
    if _is_hand(file):
        if points.shape[1] != JOINT_COUNT:
            raise NoMotionError(f"{points.shape[1]} points where a hand has {JOINT_COUNT}")
        return [_track(points, 0, side_of(file.stem))]
    if "rtmpose" in file.stem.casefold():
        raise NoMotionError("a whole body of RTMPose: the files of its hands, beside it, are read")
    first = limits.FREEMOCAP_BODY_POINTS
    if points.shape[1] < first + 2 * JOINT_COUNT:
        raise NoMotionError(f"{points.shape[1]} points, which is a body without hands")
    return [_track(points, first, Handedness.RIGHT), _track(points, first + JOINT_COUNT, Handedness.LEFT)]


def _track(points: np.ndarray, first: int, side: Handedness | None) -> HandTrack:
    joints = np.array(points[:, first : first + JOINT_COUNT], dtype=np.float64)
    joints[~np.isfinite(joints).all(axis=-1)] = np.nan
    return HandTrack(joints, side, JointOrder.STANDARD, "" if side is None else f"{side} hand")
