"""What a detector of hands says about an image, and a second look for hands that it missed."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness

# one right and one left: those of one person
HANDS_MAX = 2
# two detections nearer than this part of the hand's size are the same hand
SAME_HAND_PART = 0.35
# after so many seconds out of sight a hand's place says nothing any more
HAND_LOST_S = 0.5
# edge of the parts, of the shorter edge of the picture
SEARCH_PART = 2 / 3
# seconds between looks at all parts while no hand is seen, and beside one that is
SEARCH_S = 0.25
SEARCH_BESIDE_S = 1.0
# edge of what is looked at about a hand that was just lost, in parts of its size
CLOSE_LOOK_PART = 3.0


@dataclass(frozen=True, eq=False)
class SeenHand:
    """One hand in one picture.

    image_px:   (21, 2) landmarks, level order, pixels; (0, 0) is the top left corner of the picture
    space_m:    (21, 3) the detector's idea of the hand in space, level order: x right, y down, z away from the camera,
                about meters, around the hand's middle. Its bones wobble: their directions are what counts
    handedness: which hand it is, the right way round
    score:      how sure the detector is of the handedness, 0..1
    """

    image_px: np.ndarray
    space_m: np.ndarray
    handedness: Handedness
    score: float

    def __post_init__(self) -> None:
        for name, shape in (("image_px", (JOINT_COUNT, 2)), ("space_m", (JOINT_COUNT, 3))):
            array = np.asarray(getattr(self, name), dtype=np.float64)
            if array.shape != shape or not np.isfinite(array).all():
                raise InputError(f"detected hand: {name}", wanted=f"finite numbers {shape}", came=str(array.shape))
            object.__setattr__(self, name, array)
        object.__setattr__(self, "handedness", Handedness(self.handedness))

    @property
    def middle_px(self) -> np.ndarray:
        """(2,) where the hand is."""
        return self.image_px.mean(0)

    @property
    def size_px(self) -> float:
        """How large it is: twice the landmarks' distance from their middle."""
        return float(2 * np.sqrt(np.square(self.image_px - self.middle_px).sum(-1).mean()))

    def distance_to(self, other: SeenHand) -> float:
        """In parts of the larger one's size."""
        size = max(self.size_px, other.size_px, 1e-6)
        return float(np.linalg.norm(self.middle_px - other.middle_px)) / size


class HandDetector(Protocol):
    """Finds hands in the pictures of one video, in their order."""

    def detect(self, rgb8: np.ndarray, time_s: float) -> list[SeenHand]:
        """Hands in a picture (H, W, 3) uint8 that was taken `time_s` seconds after the first one."""
        ...


class SecondLook:
    """A detector for hands that the first look missed: at parts of the picture, in which a small hand is larger.

    A detector that looks at the whole picture in few pixels overlooks small hands, and a hand that it lost it may not
    find again. So where a hand was a moment ago is looked at closely, and now and then the whole picture in parts.

    whole: follows hands through the frames of a video
    part:  looks at each image for itself
    """

    def __init__(self, whole: HandDetector, part: HandDetector) -> None:
        self._whole, self._part = whole, part
        self._last: list[tuple[float, SeenHand]] = []
        self._searched_s = -np.inf

    def detect(self, rgb8: np.ndarray, time_s: float) -> list[SeenHand]:
        """Hands in a picture; as `HandDetector`."""
        found = self._whole.detect(rgb8, time_s)
        recent = [(when, hand) for when, hand in self._last if time_s - when <= HAND_LOST_S]
        for _, hand in recent:
            if len(found) < HANDS_MAX and _is_new(hand, found):
                self._add(found, self._inside(rgb8, _around(hand, rgb8.shape)))
        every_s = SEARCH_S if not found else SEARCH_BESIDE_S
        if len(found) < HANDS_MAX and time_s - self._searched_s >= every_s:
            self._searched_s = time_s
            for box in _parts(rgb8.shape):
                if len(found) < HANDS_MAX:
                    self._add(found, self._inside(rgb8, box))
        self._last = [(time_s, hand) for hand in found] + [old for old in recent if _is_new(old[1], found)]
        return found

    def _inside(self, rgb8: np.ndarray, box: tuple[int, int, int, int]) -> list[SeenHand]:
        """Hands in the part left, top, right, bottom of a picture, pixels of the whole."""
        left, top, right, bottom = box
        hands = self._part.detect(np.ascontiguousarray(rgb8[top:bottom, left:right]), 0.0)
        return [replace(hand, image_px=hand.image_px + np.array([left, top])) for hand in hands]

    @staticmethod
    def _add(found: list[SeenHand], more: list[SeenHand]) -> None:
        found += [hand for hand in more if _is_new(hand, found)][: HANDS_MAX - len(found)]


def _is_new(hand: SeenHand, found: list[SeenHand]) -> bool:
    return all(hand.distance_to(other) > SAME_HAND_PART for other in found)


def _around(hand: SeenHand, shape: tuple[int, ...]) -> tuple[int, int, int, int]:
    """A square about where a hand was, inside the picture."""
    height, width = shape[:2]
    half = CLOSE_LOOK_PART * hand.size_px / 2
    low = np.clip(np.floor(hand.middle_px - half), 0, (width - 1, height - 1)).astype(int)
    high = np.clip(np.ceil(hand.middle_px + half), low + 1, (width, height)).astype(int)
    return int(low[0]), int(low[1]), int(high[0]), int(high[1])


def _parts(shape: tuple[int, ...]) -> Iterator[tuple[int, int, int, int]]:
    """Overlapping squares that cover a picture; a hand no larger than their overlap is whole in one of them."""
    height, width = shape[:2]
    edge = max(1, round(SEARCH_PART * min(height, width)))
    for top in _starts(height, edge):
        for left in _starts(width, edge):
            yield left, top, left + edge, top + edge


def _starts(length: int, edge: int) -> list[int]:
    count = max(2, int(np.ceil(2 * (length - edge) / edge)) + 1)
    return [round(start) for start in np.linspace(0, length - edge, count)]
