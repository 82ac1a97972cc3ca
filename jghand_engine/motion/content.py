"""What every reader of a motion file takes and gives, and how a damaged file is refused.

A format is a `Reader`: whether a source is one of its files, and the joints of the hands in it, as the file has them.
"""

from __future__ import annotations

import contextlib
import csv
import json
import struct
import tokenize
import zipfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError, MemoryLimitError, first_line
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import JointOrder
from jghand_engine.hand.sequence import MOTION_FRAMES_MAX
from jghand_engine.motion.bone_names import BoneMap

# a file larger than this, packed or unpacked, is refused: an hour at 120 frames per second has 220 MB
MOTION_MAX_BYTES = 1 << 30
# the same for text, whose numbers take ten times their characters while they are read: an hour of our own JSON at 30
# frames per second has 128 MiB, of MediaPipe's results with the landmarks of the picture some times more
MOTION_TEXT_MAX_BYTES = 1 << 29
# names under which the frames of a JSON object may be listed
_FRAME_LISTS = ("frames", "data", "samples", "recording", "results")


@dataclass(frozen=True)
class MotionFormat:
    """What the user says about a motion file; None: the file itself says it.

    order:           how the joints are listed
    unit:            'm', 'cm' or 'mm'
    handedness:      which hand it truly is, whatever a label says
    fps:             frames per second; replaces the file's, whose frames stay; animations with times in seconds are
                     taken at this rate. Neither: 30
    check_hand:      refuse joints whose bone lengths are no hand's. Turn it off for hands of odd proportions only: it
                     is what catches a wrong order or unit
    part:            which of several skeletons, people, captures: its name, or a part of it
    mirrored_labels: whether a detector's labels are those of a mirrored picture; None: as its interface usually has it
    hand_length_m:   scale the hand to this length, wrist to the middle finger's tip; a unit is not needed then
    bones:           names of a rig's bones by joint, where they are those of no convention
    up:              the axis that points up, "y" or "z"; replaces the file's
    """

    order: JointOrder | None = None
    unit: str | None = None
    handedness: Handedness | None = None
    fps: float | None = None
    check_hand: bool = True
    part: str | None = None
    mirrored_labels: bool | None = None
    hand_length_m: float | None = None
    bones: BoneMap | None = None
    up: str | None = None


@dataclass(frozen=True)
class Source:
    """A file or a folder, as readers recognize it.

    path:     of the file or folder
    head:     the beginning of the file
    document: what it holds where it is JSON
    """

    path: Path
    head: bytes = b""
    document: Any = None

    @cached_property
    def frames(self) -> list[Any]:
        """The list of frames in JSON; a document without one is a frame itself."""
        if not isinstance(self.document, dict):
            return self.document if isinstance(self.document, list) else []
        lists = {name.casefold(): value for name, value in self.document.items() if isinstance(value, list)}
        return next((lists[name] for name in _FRAME_LISTS if name in lists), [self.document])

    @property
    def fps(self) -> float | None:
        """Frames per second that JSON says beside its frames."""
        fps = self.document.get("fps") if isinstance(self.document, dict) else None
        return float(fps) if isinstance(fps, int | float) and not isinstance(fps, bool) else None


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
    times:      of its frames, where they are not those of all hands of the file
    """

    joints: np.ndarray
    handedness: Handedness | None
    order: JointOrder | None = JointOrder.STANDARD
    part: str = ""
    labeled: bool = False
    notes: tuple[str, ...] = ()
    times: Sequence[float | None] = ()


@dataclass(frozen=True)
class MotionContent:
    """A motion file as it is.

    kind:            the format, for people
    tracks:          its hands
    meters_per_unit: None where neither the file nor its format says it
    fps:             frames per second, None where the file does not say
    times:           of the frames (F,), which count more, in any unit; () without
    notes:           sentences about what was read, and how
    up:              the axis that points up, "y", "z" or "-y"; None where neither the file nor its format says it
    filled:          (F,) bool, frames that nobody measured; None: none
    forearm:         (F, 4) how it is turned, see `HandPose`; None: not known
    is_plain:        JGHand's own formats and plain arrays, whose defaults (meters, 30 fps) are documented
    files:           all that it was read from, where that is not one file alone
    """

    kind: str
    tracks: tuple[HandTrack, ...]
    meters_per_unit: float | None = None
    fps: float | None = None
    times: Sequence[float | None] = ()
    notes: tuple[str, ...] = ()
    up: str | None = None
    filled: np.ndarray | None = None
    forearm: np.ndarray | None = None
    is_plain: bool = False
    files: tuple[Path, ...] = ()


@dataclass(frozen=True)
class Reader:
    """A format.

    suffixes:   what its files are called; content decides
    recognizes: whether a source is one of them
    read:       what stands in it. NoMotionError; any error that `damage_as_input_error` tells
    """

    suffixes: tuple[str, ...]
    recognizes: Callable[[Source], bool]
    read: Callable[[Source, MotionFormat], MotionContent]


# ---- hands that are found frame by frame ----------------------------------------------------------------------------


@dataclass(frozen=True)
class FoundHand:
    """A hand in one frame.

    side:      None where nothing says it
    joints:    (n, 3)
    score:     how sure the detector was
    order:     of the joints, None where nothing says it
    in_meters: whether they are meters
    """

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
    *(csv.Error, RuntimeError, AttributeError, tokenize.TokenError, struct.error, zipfile.BadZipFile),
)


@contextlib.contextmanager
def damage_as_input_error(file: Path) -> Iterator[None]:
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
        # Python's name for it only where its text alone says nothing
        is_clear = isinstance(error, ValueError) or not str(error).strip()
        came = first_line(error) if is_clear else f"{type(error).__name__}: {first_line(error)}"
        raise InputError(f"motion file {file}", wanted="an undamaged file", came=came) from error


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
    """What a JSON file holds. InputError where it is too large."""
    check_size(file, text=True)
    return json.loads(file.read_bytes().removeprefix(b"\xef\xbb\xbf"))
