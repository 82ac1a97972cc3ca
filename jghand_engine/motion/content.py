"""What every reader of a motion file gives: joints of the hands, as the file has them; and what is wrong with it."""

from __future__ import annotations

import contextlib
import csv
import json
import struct
import tokenize
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.sequence import MOTION_FRAMES_MAX

# a file larger than this, packed or unpacked, is refused: an hour at 120 frames per second has 220 MB
MOTION_MAX_BYTES = 1 << 30
# the same for text, whose numbers take ten times their characters while they are read: an hour of our own JSON at 30
# frames per second has 128 MiB, of MediaPipe's results with the landmarks of the picture some times more
MOTION_TEXT_MAX_BYTES = 1 << 29


@dataclass(frozen=True)
class HandTrack:
    """One hand of a file over time.

    joints:     (F, n, 3) in the file's unit and axes, NaN where missing; n as `order` has it
    handedness: which hand it is, None where the file does not say
    order:      of the joints, None where the file does not say
    part:       what to call it where a file holds several hands: a skeleton, a person, a capture; may be ""
    labeled:    the side is the label of a detector, which a mirrored picture or an older package turns round: what the
                user says counts more. A side that stands in names of bones is no label
    notes:      sentences about this hand
    times:      of its frames, where they are not those of all hands of the file; as in MotionContent
    """

    joints: np.ndarray
    handedness: Handedness | None
    order: JointOrder | None = JointOrder.STANDARD
    part: str = ""
    labeled: bool = False
    notes: tuple[str, ...] = ()
    times: Sequence[float | None] = ()

    @property
    def frames_seen(self) -> int:
        """Frames in which any joint is there."""
        return int(np.isfinite(self.joints).all(axis=-1).any(axis=-1).sum())


@dataclass(frozen=True)
class MotionContent:
    """A motion file as it is.

    kind:            the format, for people
    tracks:          its hands
    meters_per_unit: None where neither the file nor its format says it
    declared_unit:   whether the file itself says the unit, so that another one is a contradiction
    fps:             frames per second, None where the file does not say
    times:           of the frames (F,), which count more, as the file has them; () without
    time_units:      in which they may be, () for any
    notes:           sentences about what was read, and how
    up:              the axis that points up, "y", "z" or "-y"; None where neither the file nor its format says it
    filled:          (F,) bool, frames that nobody measured; None: none
    is_plain:        JGHand's own formats and plain arrays, whose defaults (meters, 30 fps) are documented
    is_skeleton:     its hands were found by names of bones
    files:           all that it was read from, where that is not one file alone
    animations:      names of the animations of which one was read
    """

    kind: str
    tracks: tuple[HandTrack, ...]
    meters_per_unit: float | None = None
    declared_unit: bool = False
    fps: float | None = None
    times: Sequence[float | None] = ()
    time_units: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    up: str | None = None
    filled: np.ndarray | None = None
    is_plain: bool = False
    is_skeleton: bool = False
    files: tuple[Path, ...] = ()
    animations: tuple[str, ...] = ()


# ---- hands that are found frame by frame ----------------------------------------------------------------------------


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

    two_of_a_side: how often a side was found once more in a frame
    in_meters:     whether all hands are
    times:         of the frames, as the file has them
    """

    two_of_a_side: int = 0
    in_meters: bool = True
    times: list[float | None] = field(default_factory=list)
    _hands: dict[tuple[Handedness | None, JointOrder | None, int], dict[int, np.ndarray]] = field(default_factory=dict)

    def add(self, hands: Iterable[FoundHand], time: float | None = None) -> None:
        """The next frame. NoMotionError for more frames than a motion has."""
        check_frame_count(len(self.times) + 1)
        taken: set[Handedness | None] = set()
        for hand in sorted(hands, key=lambda hand: -hand.score):
            if hand.side in taken:
                self.two_of_a_side += 1
                continue
            taken.add(hand.side)
            self.in_meters &= hand.in_meters
            self._hands.setdefault((hand.side, hand.order, len(hand.joints)), {})[len(self.times)] = hand.joints
        self.times.append(time)

    def tracks(self, *, labeled: bool) -> tuple[HandTrack, ...]:
        """A track of each side."""
        result = []
        for (side, order, joint_count), frames in self._hands.items():
            joints = np.full((len(self.times), joint_count, 3), np.nan)
            joints[list(frames)] = np.stack(list(frames.values()))
            result.append(HandTrack(joints, side, order, "" if side is None else f"{side} hand", labeled))
        return tuple(result)


# ---- what is wrong with a file --------------------------------------------------------------------------------------


class NoMotionError(ValueError):
    """A file that may be a good one, but is none that JGHand can take a motion from; its text says why."""


# what numpy, json, csv and zip raise on a damaged file; numpy reads a header as Python literals: a flipped bit makes it
# a broken program
_DAMAGE = (
    *(ValueError, TypeError, KeyError, IndexError, EOFError, OverflowError, RecursionError, SyntaxError),
    *(csv.Error, RuntimeError, AttributeError, tokenize.TokenError, struct.error),
)


@contextlib.contextmanager
def told_damage(file: Path) -> Iterator[None]:
    """What readers raise on a damaged file, said in one sentence: InputError, MemoryLimitError."""
    try:
        yield
    except OSError as error:
        raise InputError(f"cannot read motion file {file}", came=str(error.strerror or error)) from error
    except MemoryError as error:
        raise MemoryLimitError(
            f"motion file {file}", wanted="memory to read it", came="none left", remedy="Cut it into shorter motions."
        ) from error
    except NoMotionError as error:
        raise InputError(f"motion file {file}: {error}") from error
    except _DAMAGE as error:
        raise InputError(f"motion file {file}", wanted="an undamaged file", came=_one_line(error)) from error


def _one_line(error: BaseException) -> str:
    """The first line of an error; Python's name for it only where its text alone says nothing."""
    text = str(error).strip().splitlines()
    if not text:
        return type(error).__name__
    return text[0][:200] if isinstance(error, ValueError) else f"{type(error).__name__}: {text[0][:200]}"


def check_size(file: Path, *, text: bool) -> None:
    """InputError for a file that is larger than any motion. text: JSON, CSV and BVH, whose numbers grow."""
    size, most = file.stat().st_size, MOTION_TEXT_MAX_BYTES if text else MOTION_MAX_BYTES
    if size > most:
        raise InputError(
            f"motion file {file}",
            wanted=f"at most {most / 2**20:.0f} MiB",
            came=f"{size / 2**20:.0f} MiB",
            remedy="Cut it into shorter motions, or write it as .npz." if text else "Cut it into shorter motions.",
        )


def check_frame_count(frames: int) -> None:
    """NoMotionError for more frames than a motion has."""
    if frames > MOTION_FRAMES_MAX:
        raise NoMotionError(f"more than {MOTION_FRAMES_MAX} frames")


def json_content(file: Path) -> Any:
    """What a JSON file holds. InputError where it is too large; what `told_damage` tells for one that is none."""
    check_size(file, text=True)
    return json.loads(file.read_bytes().removeprefix(b"\xef\xbb\xbf"))
