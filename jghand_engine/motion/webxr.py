"""Hands of headsets as JSON: recordings of WebXR and OpenXR, 25 or 26 joints of a hand.

    IWER      {"schema": [[0, {"handedness", "hasHand", "jointSequence", …}]], "frames": [[milliseconds, …]]}, as the
              action recorder of Meta's Immersive Web Emulation Runtime writes it. Numbers have three digits behind the
              point, which is a millimeter; the joints are relative to the source's target ray
    others    frames of {"left": hand, "right": hand}, of {"hands": [{"handedness", "joints"}]} or of one hand, where a
              hand is a list of 25 (WebXR) or 26 (OpenXR) points, or points under the joints' names

WebXR and OpenXR have no file format; both have meters and y up.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.rotations import quaternion_rotation
from jghand_engine.motion.content import (
    FoundHand,
    FrameHands,
    MotionContent,
    MotionFormat,
    NoMotionError,
    Reader,
    Source,
)
from jghand_engine.motion.points import by_plain_name, named_points, points, time_in

# frames in which a hand is looked for before a file is given up: it may not be there from the beginning
_FRAMES_LOOKED_AT = 5000
_XR_COUNTS, _XR_CONVENTIONS = (25, 26), ("WebXR", "OpenXR")
# in IWER's frames: numbers of the viewer (time, position, quaternion); of a source's index, position and quaternion of
# its target ray; of a joint's position, quaternion and radius
_VIEWER_NUMBERS, _RAY_NUMBERS, _JOINT_NUMBERS = 8, 8, 8


def _recognizes(source: Source) -> bool:
    return any(map(_hands_or_none, source.frames[:_FRAMES_LOOKED_AT]))


def _hands_or_none(frame: Any) -> list[FoundHand]:
    try:
        return _hands(frame)
    except ValueError:
        return []


def _read(source: Source, _wanted: MotionFormat) -> MotionContent:
    collected = FrameHands()
    for frame in source.frames:
        collected.add(_hands(frame), time_in(by_plain_name(frame)))
    # a headset counts meters; of joints that are not a headset's nothing is known
    kind, meters, up = ("joints of a headset", 1.0, "y") if collected.in_meters else ("joints in JSON", None, None)
    tracks = collected.tracks(labeled=False)
    return MotionContent(kind, tracks, meters, fps=source.fps, times=collected.times, up=up)


def _hands(frame: Any) -> list[FoundHand]:
    """The hands of a frame. ValueError for points that are none."""
    if isinstance(frame, list):
        joints = points(frame)
        if joints is not None:
            if len(joints) in _XR_COUNTS:
                return [FoundHand(None, joints, order=JointOrder.OPENXR, in_meters=True)]
            return [FoundHand(None, joints)] if len(joints) == JOINT_COUNT else []
        return [hand for one in frame if isinstance(one, Mapping) for hand in _hands(one)]
    members = by_plain_name(frame)
    if not members:
        return []
    sided = [
        replace(hand, side=side)
        for side in Handedness
        for key in (side.value, f"{side.value}hand")
        for hand in _hands(members.get(key))
    ]
    if sided:
        return sided
    if isinstance(members.get("hands"), list | dict):
        return _hands(members["hands"])
    label = str(members.get("handedness", members.get("hand"))).casefold()
    side = next((side for side in Handedness if label == side.value), None)
    inside = next((members[name] for name in ("joints", "hand", "points", "landmarks") if name in members), None)
    if isinstance(inside, list | dict):
        return [replace(hand, side=side if hand.side is None else hand.side) for hand in _hands(inside)]
    return [
        FoundHand(hand.handedness or side, joints, 1.0, JointOrder.STANDARD, hand.convention in _XR_CONVENTIONS)
        for hand, joints in named_points(frame)
    ]


# ---- recordings of IWER ----------------------------------------------------------------------------------------------


def _is_recording(source: Source) -> bool:
    about = source.document
    return isinstance(about, dict) and "schema" in about and isinstance(about.get("frames"), list)


def _read_recording(source: Source, _wanted: MotionFormat) -> MotionContent:
    sources = {int(number): about for number, about in source.document["schema"]}
    collected = FrameHands()
    for frame in source.frames:
        hands = [hand for entry in frame[_VIEWER_NUMBERS:] if (hand := _recorded(entry, sources)) is not None]
        collected.add(hands, float(frame[0]))
    tracks = collected.tracks(labeled=False)
    if not tracks:
        raise NoMotionError("none of its input sources is a hand")
    notes = ("IWER rounds positions to a millimeter.",)
    return MotionContent("a WebXR recording of IWER", tracks, 1.0, times=collected.times, notes=notes, up="y")


def _recorded(entry: list[Any], sources: Mapping[int, Mapping[str, Any]]) -> FoundHand | None:
    """One input source of a frame: index, target ray (7), then a list each for grip, hand and gamepad."""
    source = sources.get(entry[0], {})
    place = _RAY_NUMBERS + bool(source.get("hasGrip"))
    if not source.get("hasHand") or "jointSequence" not in source or place >= len(entry):
        return None
    joints = np.array(entry[place], dtype=np.float64).reshape(-1, _JOINT_NUMBERS)[:, :3]
    ray = np.array(entry[1:_RAY_NUMBERS], dtype=np.float64)
    x, y, z, w = ray[3:] / np.linalg.norm(ray[3:])
    joints = joints @ quaternion_rotation(np.array([w, x, y, z])).T + ray[:3]
    found = named_points(dict(zip(source["jointSequence"], joints.tolist(), strict=True)))
    if not found:
        raise NoMotionError("joints that are not named as WebXR does")
    side = next((side for side in Handedness if side.value == source.get("handedness")), None)
    return FoundHand(side, found[0][1], order=JointOrder.STANDARD, in_meters=True)


RECORDING = Reader((".json",), _is_recording, _read_recording)
READER = Reader((".json",), _recognizes, _read)
