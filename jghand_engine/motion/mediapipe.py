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

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.content import (
    FoundHand,
    FrameHands,
    MotionContent,
    MotionFormat,
    NoMotionError,
    Reader,
    Source,
)
from jghand_engine.motion.points import by_plain_name, points, time_in

_WORLD = ("worldlandmarks", "handworldlandmarks", "multihandworldlandmarks")
_IMAGE = ("landmarks", "handlandmarks", "multihandlandmarks", "righthandlandmarks", "lefthandlandmarks")
_OF_SIDE = {"righthandworldlandmarks": Handedness.RIGHT, "lefthandworldlandmarks": Handedness.LEFT}
_LABELS = ("handedness", "handednesses", "multihandedness")
# what only the old interface says, whose labels are those of a mirrored picture
_MIRRORED = ("multihandedness", "multihandworldlandmarks")


def _recognizes(source: Source) -> bool:
    return any(_is_result(set(by_plain_name(frame))) for frame in source.frames)


def _is_result(keys: set[str]) -> bool:
    has_image = keys & set(_IMAGE[1:]) or ("landmarks" in keys and keys & set(_LABELS))
    return bool(keys & {*_WORLD, *_OF_SIDE} or has_image)


def _read(source: Source, wanted: MotionFormat) -> MotionContent:
    """A frame that is null has no hand."""
    collected, has_image, turned = FrameHands(), False, False
    for frame in map(by_plain_name, source.frames):
        hands = _hands(frame)
        has_image |= any(frame.get(name) for name in _IMAGE)
        says_mirrored = any(name in frame for name in _MIRRORED)
        if says_mirrored if wanted.mirrored_labels is None else wanted.mirrored_labels:
            turned |= any(hand.side is not None for hand in hands)
            hands = [replace(hand, side=None if hand.side is None else hand.side.other) for hand in hands]
        collected.add(hands, time_in(frame))
    tracks = collected.tracks(labeled=True)
    if has_image and not tracks:
        raise NoMotionError(
            "it holds landmarks of the image only, which have no scale and hardly a depth: save the world landmarks too"
        )
    notes = []
    if turned:
        notes.append(
            'MediaPipe\'s old interface calls a right hand of a picture that is not mirrored "Left": the labels were '
            "turned round (jghand motion --labels true keeps them)."
        )
    if collected.two_of_a_side:
        notes.append(f"{collected.two_of_a_side} frames show a side twice: the surer one was taken.")
    return MotionContent(
        "MediaPipe landmarks", tracks, 1.0, fps=source.fps, times=collected.times, notes=tuple(notes), up="-y"
    )


def _hands(frame: Mapping[str, Any]) -> list[FoundHand]:
    sided = [
        FoundHand(side, joints, order=JointOrder.STANDARD)
        for key, side in _OF_SIDE.items()
        if (joints := _joints(_only(frame.get(key)))) is not None
    ]
    listed = next((frame[key] for key in _WORLD if frame.get(key)), None)
    if sided or not isinstance(listed, list):
        return sided
    # one hand alone may stand without a list around it
    each = [listed] if _joints(listed) is not None else listed
    labels = next((frame[key] for key in _LABELS if frame.get(key)), [])
    labels = [*(labels if isinstance(labels, list) else [labels]), *[None] * len(each)]
    hands = []
    for one, label in zip(each, labels, strict=False):
        joints, (side, score) = _joints(one), _label(label)
        if joints is not None:
            hands.append(FoundHand(side, joints, score, JointOrder.STANDARD))
    return hands


def _joints(value: Any) -> Any:
    found = points(value)
    return found if found is not None and len(found) == JOINT_COUNT else None


def _only(value: Any) -> Any:
    """Holistic results list one hand in a list of its own."""
    return value[0] if isinstance(value, list) and len(value) == 1 else value


def _label(value: Any) -> tuple[Handedness | None, float]:
    """Side and score of a label: "Right", {"label": …}, {"categoryName": …}, a list of these, or what they are in."""
    if isinstance(value, list) and value:
        return _label(value[0])
    if isinstance(value, Mapping):
        named = by_plain_name(value)
        inside = named.get("classification", named.get("categories"))
        if inside is not None:
            return _label(inside)
        name, score = named.get("categoryname") or named.get("label"), named.get("score", 1.0)
        return _label(name)[0], float(score)
    return next((side for side in Handedness if side.value == str(value).casefold()), None), 1.0


READER = Reader((".json",), _recognizes, _read)
