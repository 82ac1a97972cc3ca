"""Hands of headsets as JSON: recordings of WebXR and OpenXR, 25 or 26 joints of a hand.

    IWER      {"schema": [[0, {"handedness", "hasHand", "jointSequence", …}]], "frames": [[milliseconds, …]]}, as the
              action recorder of Meta's Immersive Web Emulation Runtime writes it. Numbers have three digits behind the
              point, which is a millimeter; the joints are relative to the source's target ray
    others    frames of {"left": hand, "right": hand}, of {"hands": [{"handedness", "joints"}]} or of one hand, where a
              hand is a list of 25 (WebXR) or 26 (OpenXR) points, or points under the joints' names

WebXR and OpenXR have no file format; both have meters and y up.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.clocks import plain, time_in
from jghand_engine.motion.content import FoundHand, FrameHands, MotionContent, NoMotionError
from jghand_engine.motion.points import named_points, points
from jghand_engine.motion.skeleton import rotation_matrices

IWER_KIND, KIND = "a WebXR recording of IWER", "joints of a headset"
_JOINT_NUMBERS = 8  # position, quaternion, radius
_VIEWER_NUMBERS, _RAY_NUMBERS = 8, 8  # time or index, position, quaternion
_LISTS = ("hands", "inputsources", "inputs", "sources", "controllers")
_XR_COUNTS, _XR_CONVENTIONS = (25, 26), ("WebXR", "OpenXR")


def looks_like(frame: Any) -> bool:
    """Whether one frame holds hands of a headset."""
    try:
        return bool(_hands(frame))
    except ValueError:
        return False


def read(frames: Iterable[Any], fps: float | None) -> MotionContent:
    """The hands in a row of frames. ValueError says what is wrong."""
    collected = FrameHands()
    for frame in frames:
        collected.add(_hands(frame), time_in(_by_key(frame)))
    tracks = collected.tracks(labeled=False)
    # a headset counts meters; of joints that are not a headset's nothing is known
    kind, meters = (KIND, 1.0) if collected.in_meters else ("joints in JSON", None)
    up = "y" if collected.in_meters else None
    return MotionContent(kind, tracks, meters, fps=fps, times=collected.times, up=up)


def read_iwer(schema: Any, frames: Iterable[Any]) -> MotionContent:
    """A recording of IWER's action recorder. ValueError, TypeError or IndexError for one that is none."""
    sources = {int(number): source for number, source in schema}
    collected = FrameHands()
    for number, frame in enumerate(frames):
        if not isinstance(frame, list) or len(frame) < _VIEWER_NUMBERS:
            raise ValueError(f"frame {number} is none of IWER's")
        hands = [hand for entry in frame[_VIEWER_NUMBERS:] if (hand := _iwer_hand(entry, sources)) is not None]
        collected.add(hands, float(frame[0]))
    tracks = collected.tracks(labeled=False)
    if not tracks:
        raise NoMotionError("none of its input sources is a hand")
    notes = ("IWER rounds positions to a millimeter.",)
    times = collected.times
    return MotionContent(IWER_KIND, tracks, 1.0, times=times, time_units=("milliseconds",), notes=notes, up="y")


def _iwer_hand(entry: list[Any], sources: Mapping[int, Mapping[str, Any]]) -> FoundHand | None:
    """One input source of a frame: index, target ray (7), then a list each for grip, hand and gamepad."""
    source = sources.get(entry[0], {})
    place = _RAY_NUMBERS + bool(source.get("hasGrip"))
    if not source.get("hasHand") or "jointSequence" not in source or place >= len(entry):
        return None
    names = [str(name) for name in source["jointSequence"]]
    numbers = np.array(entry[place], dtype=np.float64)
    if numbers.shape != (len(names) * _JOINT_NUMBERS,):
        raise ValueError(f"{numbers.size} numbers of a hand where its schema has {len(names)} joints")
    ray = np.array(entry[1:_RAY_NUMBERS], dtype=np.float64)
    joints = numbers.reshape(-1, _JOINT_NUMBERS)[:, :3] @ rotation_matrices(ray[3:]).T + ray[:3]
    found = named_points(dict(zip(names, joints.tolist(), strict=True)))
    if not found:
        raise NoMotionError("joints that are not named as WebXR does")
    return FoundHand(_side(source.get("handedness")), found[0][1], order=JointOrder.STANDARD, in_meters=True)


def _hands(frame: Any) -> list[FoundHand]:
    """The hands of a frame."""
    if isinstance(frame, list):
        joints = points(frame)
        if joints is not None:
            if len(joints) in _XR_COUNTS:
                return [FoundHand(None, joints, order=JointOrder.OPENXR, in_meters=True)]
            return [FoundHand(None, joints)] if len(joints) == JOINT_COUNT else []
        return [hand for one in frame if isinstance(one, Mapping) for hand in _hands(one)]
    by_key = _by_key(frame)
    if not by_key:
        return []
    sided = [
        replace(hand, side=side)
        for side in Handedness
        for key in (side.value, f"{side.value}hand", f"hand{side.value}")
        for hand in _hands(by_key.get(key))
    ]
    if sided:
        return sided
    for name in _LISTS:
        if isinstance(by_key.get(name), list | dict):
            return _hands(by_key[name])
    side = _side(by_key.get("handedness", by_key.get("hand", by_key.get("side"))))
    inside = next((by_key[name] for name in ("joints", "hand", "points", "landmarks") if name in by_key), None)
    if isinstance(inside, list | dict):
        return [replace(hand, side=side if hand.side is None else hand.side) for hand in _hands(inside)]
    return [
        FoundHand(hand.handedness or side, joints, 1.0, JointOrder.STANDARD, hand.convention in _XR_CONVENTIONS)
        for hand, joints in named_points(frame)
    ]


def _by_key(frame: Any) -> dict[str, Any]:
    """The members of a frame by their plain names; {} for one that has none."""
    return {plain(str(key)): value for key, value in frame.items()} if isinstance(frame, Mapping) else {}


def _side(value: Any) -> Handedness | None:
    text = str(value).casefold()
    return next((side for side in Handedness if text in (side.value, side.value[0])), None)
