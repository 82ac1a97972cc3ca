"""Hands of OpenPose: a JSON file for every frame, `NAME_000000000012_keypoints.json`, in a folder, or one file alone.

Each holds {"people": [{"hand_right_keypoints_3d": [x, y, z, c, …], …}]}, 21 keypoints in the standard order; c is 0
where a point was not found. Only OpenPose's 3D output has a depth; its unit is that of the camera calibration.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.sequence import MOTION_FRAMES_MAX
from jghand_engine.motion.content import (
    FoundHand,
    FrameHands,
    MotionContent,
    MotionFormat,
    NoMotionError,
    Reader,
    Source,
    json_content,
)

_NUMBERED = re.compile(r"(.*?)(\d{1,15})_keypoints\.json")


def _recognizes(source: Source) -> bool:
    if source.path.is_dir():
        return next(source.path.glob("*_keypoints.json"), None) is not None
    return isinstance(source.document, Mapping) and isinstance(source.document.get("people"), list)


def _read(source: Source, _wanted: MotionFormat) -> MotionContent:
    """A folder's frames in the order of their numbers: numbers that are left out are frames without a hand."""
    if not source.path.is_dir():
        return _content([source.document])
    found = [(_NUMBERED.fullmatch(file.name), file) for file in source.path.glob("*_keypoints.json")]
    of_number = {int(match[2]): file for match, file in found if match}
    takes = {match[1] for match, _ in found if match}
    if len(takes) != 1:
        names = ", ".join(sorted(takes))[:200] or "none with a number"
        raise NoMotionError(f"frames of one video wanted, found {names}")
    first, last = min(of_number), max(of_number)
    if last - first >= MOTION_FRAMES_MAX:
        raise NoMotionError(f"frames from {first} to {last}")
    files = {number: of_number.get(number) for number in range(first, last + 1)}
    content = _content(None if file is None else json_content(file) for file in files.values())
    return replace(content, files=tuple(file for file in files.values() if file is not None))


def _content(documents: Iterable[Any]) -> MotionContent:
    collected, flat_only, crowded = FrameHands(), 0, 0
    for document in documents:
        people = [] if document is None else document["people"]
        hands = [hand for person in people for hand in _hands(person)]
        flat_only += not hands and any(
            person.get(f"hand_{side}_keypoints_2d") for person in people for side in Handedness
        )
        crowded += len(people) > 1
        collected.add(hands)
    tracks = collected.tracks(labeled=True)
    if not tracks and flat_only:
        raise NoMotionError("its keypoints have no depth: let OpenPose find hands in 3D, with several cameras")
    if not tracks:
        raise NoMotionError("no keypoints of hands in it: let OpenPose find hands too")
    notes = [f"{crowded} frames show several people: the surest hand of each side was taken."] if crowded else []
    return MotionContent("OpenPose keypoints", tracks, notes=tuple(notes))


def _hands(person: Mapping[str, Any]) -> list[FoundHand]:
    hands = []
    for side in Handedness:
        numbers = person.get(f"hand_{side}_keypoints_3d")
        if not numbers:
            continue
        values = np.array(numbers, dtype=np.float64).reshape(JOINT_COUNT, 4)
        joints = np.where(values[:, 3:] > 0, values[:, :3], np.nan)
        if np.isfinite(joints).any():
            hands.append(FoundHand(side, joints, float(values[:, 3].sum()), JointOrder.STANDARD))
    return hands


READER = Reader((".json",), _recognizes, _read)
