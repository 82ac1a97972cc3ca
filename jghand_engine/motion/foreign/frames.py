"""Hands that were found frame by frame, put together to tracks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from jghand_engine import limits
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.motion.foreign.content import HandTrack
from jghand_engine.motion.foreign.damage import NoMotionError


@dataclass(frozen=True)
class FoundHand:
    """A hand in one frame: its side, None where nothing says it; (n, 3) joints; how sure the detector was; their order,
    None where nothing says it; whether they are meters."""

    side: Handedness | None
    joints: np.ndarray
    score: float = 1.0
    order: JointOrder | None = None
    in_meters: bool = False


@dataclass
class FrameHands:
    """Collects the hands of frame after frame; the surest of each side counts.

    two_of_a_side: how often a side was found once more in a frame · in_meters: whether all hands are · times: of the
    frames, as the file has them
    """

    two_of_a_side: int = 0
    in_meters: bool = True
    times: list[float | None] = field(default_factory=list)
    _hands: dict[tuple[Handedness | None, JointOrder | None, int], dict[int, np.ndarray]] = field(default_factory=dict)

    @property
    def count(self) -> int:
        """Frames so far."""
        return len(self.times)

    def add(self, hands: Iterable[FoundHand], time: float | None = None) -> None:
        """The next frame. NoMotionError for more frames than a motion has."""
        if self.count >= limits.MOTION_FRAMES_MAX:
            raise NoMotionError(f"more than {limits.MOTION_FRAMES_MAX} frames")
        taken: set[Handedness | None] = set()
        for hand in sorted(hands, key=lambda hand: -hand.score):
            if hand.side in taken:
                self.two_of_a_side += 1
                continue
            taken.add(hand.side)
            self.in_meters &= hand.in_meters
            self._hands.setdefault((hand.side, hand.order, len(hand.joints)), {})[self.count] = hand.joints
        self.times.append(time)

    def tracks(self, *, labeled: bool) -> tuple[HandTrack, ...]:
        """A track of each side."""
        result = []
        for (side, order, joint_count), frames in self._hands.items():
            joints = np.full((self.count, joint_count, 3), np.nan)
            joints[list(frames)] = np.stack(list(frames.values()))
            result.append(HandTrack(joints, side, order, "" if side is None else f"{side} hand", labeled))
        return tuple(result)
