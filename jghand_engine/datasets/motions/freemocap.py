"""What FreeMoCap leaves in `output_data`: hands as .npy and .csv, millimetres, MediaPipe's landmarks.

    mediapipe_right_hand_3d_xyz.npy   (F, 21, 3), older recordings right_hand_3d_xyz.npy; the name says the hand
    mediapipe_right_hand_3d_xyz.csv   columns right_hand_wrist_x, …; the names say the hand
    mediapipe_skeleton_3d.npy         (F, 75 or more, 3): 33 points of the body, right hand, left hand, face; older
                                      recordings mediaPipeSkel_3d_body_hands_face.npy, NAME_frame_name_xyz.npy
    a recording's folder              both hands of its output_data
Rates are not in them: FreeMoCap records as its cameras do.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from jghand_engine import limits
from jghand_engine.datasets.motions.bone_names import side_of
from jghand_engine.datasets.motions.content import HandTrack, MotionContent
from jghand_engine.datasets.motions.damage import NoMotionError
from jghand_engine.datasets.motions.tables import read_tracks
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METRES_PER_UNIT, JointOrder

KIND = "FreeMoCap"
_HAND = re.compile(r"(right|left)_hand(_3d_xyz|_(right|left)_hand)$", re.IGNORECASE)
_BODY = re.compile(r"(skeleton_3d|skel_3d_body_hands_face|frame_name_xyz)$", re.IGNORECASE)
_FOLDER = "output_data"


def looks_like(file: Path) -> bool:
    """Whether the name of an .npy or .csv file is one of FreeMoCap's."""
    return bool(_HAND.search(file.stem) or _BODY.search(file.stem))


def hand_files(folder: Path) -> list[Path]:
    """The files of hands in a recording's folder, or in its output_data; .npy where there are both."""
    for place in (folder, folder / _FOLDER):
        for suffix in (".npy", ".csv"):
            files = sorted(file for file in place.glob(f"*{suffix}") if _HAND.search(file.stem))
            if files:
                return files
    return []


def read(files: list[Path]) -> MotionContent:
    """The hands in some files of one recording. ValueError, OSError."""
    tracks = [track for file in files for track in (_table(file) if file.suffix.lower() == ".csv" else _array(file))]
    return MotionContent(KIND, tuple(tracks), METRES_PER_UNIT["mm"], up="z", files=tuple(files))


def _table(file: Path) -> tuple[HandTrack, ...]:
    tracks, _ = read_tracks(file)
    if not tracks:
        raise NoMotionError(f"{file.name} has no columns of a hand")
    return tracks


def _array(file: Path) -> list[HandTrack]:
    # mapped: of a whole body only the hands are read
    points = np.load(file, mmap_mode="r", allow_pickle=False)
    if points.ndim != 3 or points.shape[-1] != 3 or points.dtype.kind != "f":
        raise ValueError(f"numbers of shape {points.shape} where (frames, points, 3) were wanted")
    if len(points) > limits.MOTION_FRAMES_MAX:
        raise NoMotionError(f"more than {limits.MOTION_FRAMES_MAX} frames")
    if _HAND.search(file.stem):
        if points.shape[1] != JOINT_COUNT:
            raise NoMotionError(f"{points.shape[1]} points where a hand has {JOINT_COUNT}")
        return [_track(points, 0, side_of(file.stem))]
    first = limits.FREEMOCAP_BODY_POINTS
    if points.shape[1] < first + 2 * JOINT_COUNT:
        raise NoMotionError(f"{points.shape[1]} points, which is a body without hands")
    return [_track(points, first, Handedness.RIGHT), _track(points, first + JOINT_COUNT, Handedness.LEFT)]


def _track(points: np.ndarray, first: int, side: Handedness | None) -> HandTrack:
    joints = np.array(points[:, first : first + JOINT_COUNT], dtype=np.float64)
    joints[~np.isfinite(joints).all(axis=-1)] = np.nan
    return HandTrack(joints, side, JointOrder.STANDARD, "" if side is None else f"{side} hand")
