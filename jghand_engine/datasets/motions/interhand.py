"""The 3D joints of InterHand2.6M as a motion: `InterHand2.6M_SPLIT_joint_3d.json`. DATA 5.

{capture: {frame: {"world_coord": 42 x 3, millimetres, right hand first, "joint_valid": 42}}}. A capture is a person,
whose sequences follow one another; frames that are left out are counted as gaps only within a sequence's own step.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from jghand_engine import limits
from jghand_engine.datasets.motions.content import HandTrack, MotionContent
from jghand_engine.datasets.motions.json_text import JsonText
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import METRES_PER_UNIT, JointOrder

KIND = "InterHand2.6M joints"


def looks_like(text: JsonText) -> bool:
    """Whether the first frame of the first capture is one of InterHand2.6M."""
    for _, place in text.members(text.start):
        if text.text[place] != "{":
            return False
        for _, inside in text.members(place):
            frame = text.value(inside) if text.text[inside] == "{" else None
            return isinstance(frame, Mapping) and "world_coord" in frame
        return False
    return False


def read(text: JsonText) -> MotionContent:
    """Both hands of every capture. ValueError says what is wrong."""
    tracks: list[HandTrack] = []
    frame_count = 0
    for capture, place in text.members(text.start):
        frames: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        for name, inside in text.members(place):
            frames[int(name)] = _frame(text.value(inside), f"capture {capture}, frame {name}")
            if len(frames) > limits.MOTION_FRAMES_MAX:
                raise ValueError(f"more than {limits.MOTION_FRAMES_MAX} frames")
        numbers = sorted(frames)
        joints = np.full((len(numbers), 2 * JOINT_COUNT, 3), np.nan)
        for row, number in enumerate(numbers):
            coordinates, valid = frames[number]
            joints[row] = np.where(valid[:, None], coordinates, np.nan)
        frame_count = max(frame_count, len(numbers))
        for side, first in ((Handedness.RIGHT, 0), (Handedness.LEFT, JOINT_COUNT)):
            hand = joints[:, first : first + JOINT_COUNT]
            tracks.append(HandTrack(hand, side, JointOrder.INTERHAND, f"Capture{capture}, {side} hand"))
    notes = ("InterHand2.6M lists the sequences of a person one after the other, without their rate: --fps says it.",)
    return MotionContent(KIND, tuple(tracks), METRES_PER_UNIT["mm"], notes=notes)


def _frame(entry: Any, where: str) -> tuple[np.ndarray, np.ndarray]:
    if not isinstance(entry, Mapping) or "world_coord" not in entry:
        raise ValueError(f"{where} has no world_coord")
    coordinates = np.array(entry["world_coord"], dtype=np.float64)
    valid = np.array(entry.get("joint_valid", [1] * 2 * JOINT_COUNT), dtype=np.float64).reshape(-1)
    if coordinates.shape != (2 * JOINT_COUNT, 3) or valid.shape != (2 * JOINT_COUNT,):
        raise ValueError(f"{where}: {coordinates.shape} coordinates, {valid.shape} flags")
    return coordinates, valid > 0
