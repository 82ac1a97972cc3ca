"""The 3D joints of InterHand2.6M as a motion: `InterHand2.6M_SPLIT_joint_3d.json`. DATA 5.

{capture: {frame: {"world_coord": 42 x 3, millimeters, right hand first, "joint_valid": 42}}}. A capture is a person,
whose sequences follow one another. Numbers of frames rise by the same step: a few that are left out are a gap, and
after a longer jump another sequence begins, with a part of its own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder
from jghand_engine.motion.content import HandTrack, MotionContent, MotionFormat, Reader, Source, check_frame_count

# frames that may be left out before it is another sequence: a second
GAP_STEPS = 30


def _recognizes(source: Source) -> bool:
    capture = next(iter(source.document.values()), None) if isinstance(source.document, Mapping) else None
    frame = next(iter(capture.values()), None) if isinstance(capture, Mapping) else None
    return isinstance(frame, Mapping) and "world_coord" in frame


def _read(source: Source, _wanted: MotionFormat) -> MotionContent:
    """Both hands of every sequence of every capture."""
    tracks: list[HandTrack] = []
    for capture, entries in source.document.items():
        check_frame_count(len(entries))
        frames = {int(name): _frame(entry) for name, entry in entries.items()}
        sequences = list(_sequences(frames))
        for first, joints in sequences:
            part = f"Capture{capture}" + (f", from {first}" if len(sequences) > 1 else "")
            for side, hand in zip((Handedness.RIGHT, Handedness.LEFT), np.split(joints, 2, axis=1), strict=True):
                tracks.append(HandTrack(hand, side, JointOrder.INTERHAND, f"{part}, {side} hand"))
    return MotionContent("InterHand2.6M joints", tuple(tracks), METERS_PER_UNIT["mm"])


def _sequences(frames: dict[int, np.ndarray]) -> Iterator[tuple[int, np.ndarray]]:
    """The first frame's number and the joints (F, 42, 3) of one sequence after the other: where a number jumps by more
    than some steps another one begins."""
    numbers = np.array(sorted(frames))
    steps = np.diff(numbers)
    values, counts = np.unique(steps, return_counts=True)
    step = int(values[counts.argmax()]) if len(steps) else 1
    another = (steps > GAP_STEPS * step) | (steps % step != 0)
    for some in np.split(numbers, np.flatnonzero(another) + 1):
        count = int(some[-1] - some[0]) // step + 1
        check_frame_count(count)
        joints = np.full((count, 2 * JOINT_COUNT, 3), np.nan)
        joints[(some - some[0]) // step] = [frames[number] for number in some]
        yield int(some[0]), joints


def _frame(entry: Mapping[str, Any]) -> np.ndarray:
    coordinates = np.array(entry["world_coord"], dtype=np.float64).reshape(2 * JOINT_COUNT, 3)
    valid = np.array(entry.get("joint_valid", [1] * 2 * JOINT_COUNT)).reshape(2 * JOINT_COUNT, 1)
    return np.where(valid > 0, coordinates, np.nan)


READER = Reader((".json",), _recognizes, _read)
