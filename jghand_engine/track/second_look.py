"""A second look for hands that the first one missed: at parts of the picture, in which a small hand is larger.

A detector that looks at the whole picture in few pixels overlooks small hands, and a hand that it lost it may not find
again. So where a hand was a moment ago is looked at closely, and now and then the whole picture in overlapping parts.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jghand_engine.track.detection import HANDS_MAX, HandDetector, SeenHand
from jghand_engine.track.hands_over_time import HAND_LOST_S, SAME_HAND_PART, distance

# edge of the parts, of the shorter edge of the picture
SEARCH_PART = 2 / 3
# seconds between looks at all parts while no hand is seen, and beside one that is
SEARCH_S = 0.25
SEARCH_BESIDE_S = 1.0
# edge of what is looked at about a hand that was just lost, in parts of its size
CLOSE_LOOK_PART = 3.0


class SecondLook:
    """A `HandDetector` made of two. whole: follows hands through the pictures of a video · part: looks at each picture
    for itself. Neither is closed."""

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

    def close(self) -> None:
        """There is nothing of its own to give back."""

    def _inside(self, rgb8: np.ndarray, box: tuple[int, int, int, int]) -> list[SeenHand]:
        """Hands in the part left, top, right, bottom of a picture, pixels of the whole."""
        left, top, right, bottom = box
        hands = self._part.detect(np.ascontiguousarray(rgb8[top:bottom, left:right]), 0.0)
        return [replace(hand, image_px=hand.image_px + np.array([left, top])) for hand in hands]

    @staticmethod
    def _add(found: list[SeenHand], more: list[SeenHand]) -> None:
        found += [hand for hand in more if _is_new(hand, found)][: HANDS_MAX - len(found)]


def _is_new(hand: SeenHand, found: list[SeenHand]) -> bool:
    return all(distance(hand, other) > SAME_HAND_PART for other in found)


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
