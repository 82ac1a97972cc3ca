"""Hands of OpenPose: a JSON file for every frame, `NAME_000000000012_keypoints.json`, in a folder, or one file alone.

Each holds {"people": [{"hand_right_keypoints_3d": [x, y, z, c, …], …}]}, 21 keypoints in the standard order; c is 0
where a point was not found. Only OpenPose's 3D output has a depth; its unit is that of the camera calibration.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.sequence import MOTION_FRAMES_MAX
from jghand_engine.motion.content import FoundHand, FrameHands, MotionContent, NoMotionError, json_content

KIND = "OpenPose keypoints"
SUFFIX = "_keypoints.json"
_NUMBER = re.compile(r"(\d+)_keypoints\.json$")
_FLAT = "hand_{side}_keypoints_2d"
_DEEP = "hand_{side}_keypoints_3d"


def looks_like(document: Any) -> bool:
    """Whether a JSON object is a frame of OpenPose."""
    return isinstance(document, Mapping) and isinstance(document.get("people"), list)


def read_folder(folder: Path) -> MotionContent:
    """All frames of a folder, in the order of their numbers; numbers that are left out are frames without a hand."""
    files = sorted((_frame_number(file), file) for file in folder.glob(f"*{SUFFIX}"))
    if not files:
        raise NoMotionError(f"no file *{SUFFIX} in it")
    takes = {file.name[: _NUMBER.search(file.name).start()] for _, file in files if _NUMBER.search(file.name)}  # type: ignore[union-attr]
    if len(takes) > 1:
        raise NoMotionError(f"frames of several videos in it: {', '.join(sorted(takes))[:200]}")
    first, last = files[0][0], files[-1][0]
    if last - first >= MOTION_FRAMES_MAX:
        raise NoMotionError(f"frames from {first} to {last}")
    of_number = dict(files)
    content = read(
        json_content(of_number[number]) if number in of_number else None for number in range(first, last + 1)
    )
    return replace(content, files=tuple(of_number.values()))


def read(documents: Iterable[Any]) -> MotionContent:
    """Frames, None where there is none. ValueError when there are no 3D keypoints of hands."""
    collected, flat_only, crowded = FrameHands(), 0, 0
    for number, document in enumerate(documents):
        if document is None:
            collected.add(())
            continue
        if not looks_like(document):
            raise ValueError(f"frame {number} is none of OpenPose's")
        people = [person for person in document["people"] if isinstance(person, Mapping)]
        hands = [hand for person in people for hand in _hands(person)]
        flat_only += not hands and any(person.get(_FLAT.format(side=side)) for person in people for side in Handedness)
        crowded += len(people) > 1
        collected.add(hands)
    tracks = collected.tracks(labeled=True)
    if not any(track.frames_seen for track in tracks):
        if flat_only:
            raise NoMotionError("its keypoints have no depth: run OpenPose with several cameras and --3d --hand")
        raise NoMotionError("no keypoints of hands in it: run OpenPose with --hand")
    notes = [f"{crowded} frames show several people: the surest hand of each side was taken."] if crowded else []
    return MotionContent(KIND, tracks, notes=tuple(notes))


def _hands(person: Mapping[str, Any]) -> list[FoundHand]:
    hands = []
    for side in Handedness:
        numbers = person.get(_DEEP.format(side=side))
        if not numbers:
            continue
        if not isinstance(numbers, list) or len(numbers) != 4 * JOINT_COUNT:
            raise ValueError(f"a hand of {len(numbers)} numbers where 84 were wanted")
        values = np.array(numbers, dtype=np.float64).reshape(JOINT_COUNT, 4)
        joints = np.where(values[:, 3:] > 0, values[:, :3], np.nan)
        if np.isfinite(joints).any():
            hands.append(FoundHand(side, joints, float(values[:, 3].sum()), JointOrder.STANDARD))
    return hands


def _frame_number(file: Path) -> int:
    match = _NUMBER.search(file.name)
    if match is None or len(match[1]) > 15:
        raise NoMotionError(f"{file.name} has no number of a frame")
    return int(match[1])
