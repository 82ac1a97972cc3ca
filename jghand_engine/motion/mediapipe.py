"""Hand landmarks of MediaPipe as JSON: a list of results, one for each frame, however they were written.

MediaPipe has no file format of its own; people write its results down. Read are its own names for them, in camel case
or with underscores, in a list of frames, in {"frames": […]}, or as one result alone:

    Tasks        worldLandmarks, handedness: [[{"categoryName": "Right", "score": …}]]
    Holistic     rightHandWorldLandmarks, leftHandWorldLandmarks
    Solutions    multiHandWorldLandmarks, multiHandedness: [{"label": "Left", …}] or {"classification": [{…}]}

World landmarks are meters, in the standard order. Image landmarks have no scale and hardly a depth: they are refused.
The old interface (Solutions) expects mirrored pictures and calls a right hand "Left"; its labels are turned round.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.clocks import plain, time_in
from jghand_engine.motion.content import FoundHand, FrameHands, MotionContent, NoMotionError
from jghand_engine.motion.points import points

KIND = "MediaPipe landmarks"
_WORLD = ("worldlandmarks", "multihandworldlandmarks", "handworldlandmarks", "handsworldlandmarks")
_IMAGE = ("landmarks", "multihandlandmarks", "handlandmarks", "righthandlandmarks", "lefthandlandmarks")
_OF_SIDE = {"righthandworldlandmarks": Handedness.RIGHT, "lefthandworldlandmarks": Handedness.LEFT}
_LABELS = ("handedness", "handednesses", "multihandedness")


def looks_like(frame: Any) -> bool:
    """Whether one frame is a result of MediaPipe."""
    if not isinstance(frame, Mapping):
        return False
    keys = {plain(str(key)) for key in frame}
    return (
        bool(keys & {*_WORLD, *_OF_SIDE})
        or ("landmarks" in keys and bool(keys & set(_LABELS)))
        or bool(keys & set(_IMAGE[1:]))
    )


def read(frames: Iterable[Any], fps: float | None, mirrored_labels: bool | None) -> MotionContent:
    """The hands in a row of results. mirrored_labels: whether "Left" means a right hand; None: as the interface that
    wrote them has it. ValueError when there are image landmarks only, or nothing at all."""
    collected, image_only, turned = FrameHands(), 0, 0
    for number, frame in enumerate(frames):
        if frame is None:
            collected.add(())
            continue
        if not isinstance(frame, Mapping):
            raise ValueError(f"frame {number} is no result of MediaPipe")
        by_key = {plain(str(key)): value for key, value in frame.items()}
        hands = _hands(by_key)
        image_only += not hands and any(by_key.get(name) for name in _IMAGE)
        is_mirrored = _is_old(by_key) if mirrored_labels is None else mirrored_labels
        if is_mirrored:
            turned += any(hand.side is not None for hand in hands)
            hands = [replace(one, side=None if one.side is None else one.side.other) for one in hands]
        collected.add(hands, time_in(by_key))
    if image_only and not any(track.frames_seen for track in collected.tracks(labeled=True)):
        raise NoMotionError(
            "it holds landmarks of the image only, which have no scale and hardly a depth: save the world landmarks too"
        )
    notes = []
    if turned:
        notes.append(
            'MediaPipe\'s old interface calls a right hand of a picture that is not mirrored "Left": the labels were '
            "turned round (--labels true keeps them)."
        )
    if collected.two_of_a_side:
        notes.append(f"{collected.two_of_a_side} frames show a side twice: the surer one was taken.")
    tracks = collected.tracks(labeled=True)
    return MotionContent(KIND, tracks, 1.0, fps=fps, times=collected.times, notes=tuple(notes), up="-y")


def _hands(frame: Mapping[str, Any]) -> list[FoundHand]:
    sided = [
        FoundHand(side, joints, order=JointOrder.STANDARD)
        for key, side in _OF_SIDE.items()
        if (joints := _hand(_only(frame.get(key)))) is not None
    ]
    if sided:
        return sided
    listed = next((frame[key] for key in _WORLD if frame.get(key)), None)
    if not isinstance(listed, list):
        return []
    # one hand alone may stand without a list around it
    each = [listed] if _hand(listed) is not None else listed
    labels = next((frame[key] for key in _LABELS if frame.get(key)), None)
    labels = labels if isinstance(labels, list) else [labels]
    hands = []
    for place, one in enumerate(each):
        joints = _hand(one)
        if joints is not None:
            side, score = _label(labels[place]) if place < len(labels) else (None, 1.0)
            hands.append(FoundHand(side, joints, score, JointOrder.STANDARD))
    return hands


def _hand(value: Any) -> Any:
    found = points(value)
    return found if found is not None and len(found) == JOINT_COUNT else None


def _only(value: Any) -> Any:
    """Holistic results list one hand in a list of its own."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _label(value: Any) -> tuple[Handedness | None, float]:
    """Side and score of a label: "Right", {"label": …}, {"categoryName": …}, a list of these, or what they are in."""
    if isinstance(value, list) and value:
        return _label(value[0])
    if isinstance(value, str):
        sides = [side for side in Handedness if side.value == value.casefold()]
        return (sides[0] if sides else None), 1.0
    if not isinstance(value, Mapping):
        return None, 1.0
    by_key = {plain(str(key)): entry for key, entry in value.items()}
    for inside in ("classification", "categories"):
        if inside in by_key:
            return _label(by_key[inside])
    name = next((by_key[key] for key in ("categoryname", "label", "displayname") if by_key.get(key)), None)
    score = by_key.get("score", 1.0)
    is_number = isinstance(score, int | float) and score == score
    return _label(name)[0] if isinstance(name, str) else None, float(score) if is_number else 1.0


def _is_old(frame: Mapping[str, Any]) -> bool:
    """Whether the frame has the names of the old interface."""
    return "multihandedness" in frame or "multihandworldlandmarks" in frame
