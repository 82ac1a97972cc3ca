"""From hands in single pictures to hands over time: at most one right and one left.

A detector may take a hand for the other one now and then, or find one hand twice. What moves on from where it was is
the same hand, where hands meet the one that looks like it, and which hand that is, all of its frames decide together.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from jghand_engine.hand.joints import LEVEL_NAMES, Handedness
from jghand_engine.hand.sequence import bone_directions
from jghand_engine.track.costs import SMOOTHING_FPS
from jghand_engine.track.detection import HAND_LOST_S, SAME_HAND_PART, SeenHand

# between frames a hand moves at most this part of its size per frame at 30 frames per second, else it is another one
HAND_STEP_PART = 1.2
# for so many seconds out of sight a hand that looks like it (difference in looks at most this, 0..1) is it again: it
# may have been behind the other one
HAND_HIDDEN_S = 2.0
HAND_UNLIKE_MAX = 0.5
# what a detection that looks surely like the other hand costs, in parts of the hand's size: more than a hand goes while
# it is behind the other one
HAND_UNLIKE_COST = 1.0
# what a second out of sight costs, in parts of the hand's size: a hand that is seen all the time goes on before one
# that was wrongly seen there long ago, unless it jumps by more
HAND_AWAY_COST = 0.3
# a hand that is seen for less than this is taken for a mistake: seconds, in short films a part of the pictures, and in
# any so many
HAND_SEEN_S = 2.0
HAND_SEEN_PART_MIN = 0.05
HAND_SEEN_FRAMES_MIN = 3
# a hand that shares more than this part of its pictures with another one of its kind is another person's
HAND_DOUBLE_PART = 0.25

Detections = Sequence[Sequence[SeenHand]]
_WRIST, _INDEX, _MIDDLE, _PINKY = (LEVEL_NAMES.index(name) for name in ("wrist", "index1", "middle1", "pinky1"))


@dataclass(eq=False)
class _Trail:
    """One hand from where it appears to where it is lost."""

    frames: list[int] = field(default_factory=list)
    hands: list[SeenHand] = field(default_factory=list)
    _sum: float = 0.0

    def add(self, frame: int, hand: SeenHand) -> None:
        self.frames.append(frame)
        self.hands.append(hand)
        self._sum += _rightness(hand)

    @property
    def rightness(self) -> float:
        """From -1, surely a left hand, to 1, surely a right one: labels and shape, over all frames."""
        return self._sum / len(self.hands)


@dataclass(frozen=True, eq=False)
class HandOverTime:
    """frames: for each picture the hand in it, None where it was not seen · certainty: 0..1, of which hand it is ·
    relabeled: in how many pictures the detector had taken it for the other one."""

    handedness: Handedness
    frames: tuple[SeenHand | None, ...]
    certainty: float
    relabeled: int

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool."""
        return np.array([hand is not None for hand in self.frames])


@dataclass(frozen=True)
class FoundHands:
    """hands: those that are there · doubted: those seen in so few pictures that they are taken for mistakes."""

    hands: dict[Handedness, HandOverTime]
    doubted: dict[Handedness, HandOverTime]


def hands_over_time(detections: Detections, fps: float) -> FoundHands:
    """Who is who: at most one right hand and one left."""
    parts = [part for trail in _trails(detections, fps) for part in _parts_of_one_hand(trail)]
    trails = sorted(parts, key=lambda trail: -len(trail.frames))
    chosen: dict[Handedness, list[_Trail]] = {Handedness.RIGHT: [], Handedness.LEFT: []}
    for trail in trails:
        hand = Handedness.RIGHT if trail.rightness >= 0 else Handedness.LEFT
        chosen[hand].append(trail)
    count = len(detections)
    # in how many pictures a hand must be seen
    least = min(max(HAND_SEEN_FRAMES_MIN, min(HAND_SEEN_PART_MIN * count, HAND_SEEN_S * fps)), count)
    found = FoundHands({}, {})
    for hand, own in chosen.items():
        if own:
            there = _joined(hand, own, count)
            (found.hands if there.seen.sum() >= least else found.doubted)[hand] = there
    return found


def shape_rightness(space_m: np.ndarray) -> float:
    """From -1 to 1: finger joints bend towards the palm, and which side that is tells the hand; 0: straight ones.

    space_m: (21, 3) level order, any right-handed axes.
    """
    along = space_m[_MIDDLE] - space_m[_WRIST]
    palm = np.cross(space_m[_INDEX] - space_m[_PINKY], along)
    axis = np.cross(along, palm)
    directions = bone_directions(space_m[None])[0].reshape(4, 5, 3)[:, 1:]
    # second and third joints of four fingers: they hardly bend backwards
    bends = np.cross(directions[1:3], directions[2:4]) @ axis / max(float(np.linalg.norm(axis)), 1e-12)
    return float(np.clip(bends.sum() / 2, -1, 1))


def _rightness(hand: SeenHand) -> float:
    """From -1 to 1: what label and shape say together."""
    label = hand.score if hand.handedness is Handedness.RIGHT else -hand.score
    return (label + shape_rightness(hand.space_m)) / 2


def _trails(detections: Detections, fps: float) -> list[_Trail]:
    """Each trail goes on to the nearest and likest detection that it can have reached."""
    done: list[_Trail] = []
    open_trails: list[_Trail] = []
    for frame, found in enumerate(detections):
        oldest = frame - HAND_HIDDEN_S * fps - 1
        done += [trail for trail in open_trails if trail.frames[-1] < oldest]
        open_trails = [trail for trail in open_trails if trail.frames[-1] >= oldest]
        hands = _distinct(found)
        costs = [
            (cost, number, place)
            for number, trail in enumerate(open_trails)
            for place, hand in enumerate(hands)
            if (cost := _step_cost(trail, hand, frame - trail.frames[-1], fps)) is not None
        ]
        going_on: set[int] = set()
        taken: set[int] = set()
        for _, number, place in sorted(costs):
            if number not in going_on and place not in taken:
                open_trails[number].add(frame, hands[place])
                going_on.add(number)
                taken.add(place)
        for place, hand in enumerate(hands):
            if place not in taken:
                trail = _Trail()
                trail.add(frame, hand)
                open_trails.append(trail)
    return done + open_trails


def _step_cost(trail: _Trail, hand: SeenHand, frames: int, fps: float) -> float | None:
    """How far a hand that is seen so many frames after a trail's last one is from it, in parts of its size, more where
    it looks like the other hand, and more the longer it was away; None for one that cannot be it."""
    way = trail.hands[-1].distance_to(hand)
    unlike = abs(trail.rightness - _rightness(hand)) / 2
    if way > HAND_STEP_PART * frames * max(1.0, SMOOTHING_FPS / fps):
        return None
    # of a hand that was away for long not its place but its looks tell that it is back
    if frames > HAND_LOST_S * fps + 1 and unlike > HAND_UNLIKE_MAX:
        return None
    return way + HAND_UNLIKE_COST * unlike + HAND_AWAY_COST * frames / fps


def _parts_of_one_hand(trail: _Trail) -> Iterator[_Trail]:
    """A trail in parts, cut at pauses before and after which the mean looks are those of different hands: one went and
    the other came. Where the looks change without a pause, a hand is called the other one for a while."""
    looks = np.array([_rightness(hand) for hand in trail.hands])
    least = HAND_SEEN_FRAMES_MIN
    cuts = np.flatnonzero(np.diff(trail.frames) > 1) + 1
    # fewer frames would be taken for a mistake by themselves
    cuts = cuts[(cuts >= least) & (cuts <= len(looks) - least)]
    before = np.cumsum(looks)[cuts - 1]
    after = looks.sum() - before
    unlike = np.abs(before / cuts - after / (len(looks) - cuts)) / 2
    there = unlike > HAND_UNLIKE_MAX
    if not there.any():
        yield trail
        return
    cut = int(cuts[there][np.argmax(np.abs(before - after)[there])])
    for part in (slice(None, cut), slice(cut, None)):
        own = _Trail()
        for frame, hand in zip(trail.frames[part], trail.hands[part], strict=True):
            own.add(frame, hand)
        yield from _parts_of_one_hand(own)


def _distinct(found: Sequence[SeenHand]) -> list[SeenHand]:
    """Without detections that lie on another, surer one."""
    kept: list[SeenHand] = []
    for hand in sorted(found, key=lambda hand: -hand.score):
        if all(hand.distance_to(other) > SAME_HAND_PART for other in kept):
            kept.append(hand)
    return kept


def _joined(handedness: Handedness, trails: list[_Trail], count: int) -> HandOverTime:
    """The longest trail first; a picture belongs to the first that has it. trails: longest first."""
    frames: list[SeenHand | None] = [None] * count
    used = []
    for trail in trails:
        free = [(frame, hand) for frame, hand in zip(trail.frames, trail.hands, strict=True) if frames[frame] is None]
        # a second hand of the same kind at the same time is another person's; in a few pictures, a mistake in them
        if len(trail.frames) - len(free) > HAND_DOUBLE_PART * len(trail.frames):
            continue
        for frame, hand in free:
            frames[frame] = hand
        used.append(trail)
    shown = [hand for hand in frames if hand is not None]
    certainty = float(np.average([abs(trail.rightness) for trail in used], weights=[len(t.frames) for t in used]))
    relabeled = sum(hand.handedness is not handedness for hand in shown)
    return HandOverTime(handedness, tuple(frames), certainty, relabeled)
