"""Any motion file, of JGHand or of another program, as one hand in meters; and what was recognized on the way.

What a file does not declare is recognized where joints show it, and noted: the unit by the size of the hand, the order
by the lengths of its bones. Which hand it is joints do not show: then it has to be given.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, check_hand_size, check_order, to_level
from jghand_engine.hand.sequence import FRAME_EPS, PoseSequence
from jghand_engine.motion import bvh, files, freemocap, interhand, mediapipe, openpose, tables, usd, webxr
from jghand_engine.motion.choose import chosen, recognized_order, recognized_unit, warned
from jghand_engine.motion.clocks import DEFAULT_FPS, clock_s, even_frames, is_one_motion
from jghand_engine.motion.content import (
    HandTrack,
    MotionContent,
    MotionFormat,
    NoMotionError,
    Reader,
    Source,
    check_size,
    damage_as_input_error,
    json_content,
)
from jghand_engine.motion.tools import retimed, with_hand_length

# bytes from which the format of a file is recognized
RECOGNIZE_BYTES = 1 << 16
# the first that recognizes a file reads it: those that know a name or a mark come before those that take what is left
READERS = (
    *(openpose.READER, freemocap.READER, usd.READER, files.ARRAY, files.ARCHIVE, bvh.READER),
    *(files.OBJECT, webxr.RECORDING, interhand.READER, mediapipe.READER, files.LISTS, webxr.READER, tables.READER),
)
_SKELETONS = "export BVH or USD from a program that reads it, such as Blender"
# how files begin that are not read, and what to do
_NOT_READ = {
    b"Kaydara FBX Binary": f"FBX is not read: {_SKELETONS}",
    b"; FBX": f"FBX is not read: {_SKELETONS}",
    b"glTF": f"glTF is not read: {_SKELETONS}",
    b"#VRML": f"VRML is not read: {_SKELETONS}",
    b"BLENDER": "a .blend file is not read: export BVH or USD from it",
}
# what files of motions are called; what they are their content says
_SUFFIXES = {suffix for reader in READERS for suffix in reader.suffixes}


@dataclass(frozen=True)
class MotionRead:
    """A motion that was read.

    kind:  the format it came in, for people
    notes: sentences about what was recognized or chosen
    up:    the axis that points up, "y", "z" or "-y", None where nothing says it
    files: all that it was read from
    """

    sequence: PoseSequence
    kind: str
    notes: tuple[str, ...]
    up: str | None = None
    files: tuple[Path, ...] = ()


def read_motion_file(path: Path | str, wanted: MotionFormat | None = None) -> MotionRead:
    """The motion in a file, or in a folder of OpenPose or FreeMoCap. Missing joints stay missing.

    InputError for what is absent, damaged, too large, of an unknown format, without a hand, with several of which none
    is chosen, contradicted, or no hand by the lengths of its bones; MemoryLimitError when memory runs out.
    """
    file, wanted = Path(path), wanted or MotionFormat()
    content = read_content(file, wanted)
    track, notes = chosen(file, content, wanted)
    content = replace(content, times=track.times or content.times)
    order, more = _order(file, track, wanted)
    notes += more
    level = to_level(track.joints, order)
    meters, more = _meters(file, content, level, wanted)
    notes += more
    level_m = level * meters
    if not np.isfinite(level_m).all(axis=-1).any():
        raise InputError(f"motion file {file}", wanted="a frame with joints of a hand", came="none")
    side = track.handedness if wanted.handedness is None else wanted.handedness
    if side is None:
        raise InputError(
            f"motion file {file}",
            wanted="its handedness",
            came="none declared in the file",
            remedy="Say the hand with --hand right or --hand left: joints alone do not tell it.",
        )
    if not (content.is_plain and track.handedness is not None):
        notes += warned(level_m, side)
    level_m, filled, fps, more = _evenly(file, content, level_m, wanted)
    notes += more
    sequence = PoseSequence(level_m, fps, side, filled=filled, forearm=content.forearm)
    if wanted.hand_length_m is not None:
        sequence = with_hand_length(sequence, wanted.hand_length_m)
    if wanted.check_hand and sequence.valid.all(axis=1).any():
        check_hand_size(sequence.joints_m, next((name for name, one in METERS_PER_UNIT.items() if one == meters), "m"))
        check_order(sequence.joints_m, order)
    return MotionRead(sequence, content.kind, tuple(notes), wanted.up or content.up, content.files or (file,))


def read_content(file: Path, wanted: MotionFormat) -> MotionContent:
    """What stands in a file, as it is. InputError, MemoryLimitError."""
    with damage_as_input_error(file):
        if file.is_file():
            check_size(file, text=False)
        reader, source = _recognized(file)
        content = reader.read(source, wanted)
    suffix = file.suffix.lower()
    if file.is_file() and suffix in _SUFFIXES and suffix not in reader.suffixes:
        note = f"It is called {suffix}, but by its content it is {content.kind}."
        content = replace(content, notes=(note, *content.notes))
    return content


def _recognized(path: Path) -> tuple[Reader, Source]:
    """What reads a file or a folder, and what it reads. OSError; NoMotionError says what else it is, or that nobody
    knows."""
    source = _source(path)
    reader = next((reader for reader in READERS if reader.recognizes(source)), None)
    if reader is not None:
        return reader, source
    if path.is_dir():
        raise NoMotionError(
            "a folder with neither frames of OpenPose nor hands of FreeMoCap; pictures to learn from are no motion"
        )
    if isinstance(source.document, dict) and "asset" in source.document:
        raise NoMotionError(_NOT_READ[b"glTF"])
    if source.document is not None:
        raise NoMotionError("JSON in which JGHand finds no frames of hands")
    raise NoMotionError("its beginning is that of no motion file that JGHand knows; hands in a video are tracked")


def _source(path: Path) -> Source:
    if path.is_dir():
        return Source(path)
    with open(path, "rb") as stream:
        head = stream.read(RECOGNIZE_BYTES)
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if not text:
        raise NoMotionError("it is empty")
    for mark, advice in _NOT_READ.items():
        if head.startswith(mark):
            raise NoMotionError(advice)
    is_json = text[:1] in (b"{", b"[")
    return Source(path, text, json_content(path) if is_json else None)


def _order(file: Path, track: HandTrack, wanted: MotionFormat) -> tuple[JointOrder, list[str]]:
    if wanted.order is not None:
        if track.order is not None and track.order is not wanted.order:
            raise InputError(
                f"order of {file}", wanted=f"'{track.order}', which the file has", came=f"'{wanted.order}'",
                remedy="Leave out --order.",
            )  # fmt: skip
        return wanted.order, []
    if track.order is not None:
        return track.order, []
    order, more = recognized_order(track.joints, str(file))
    return order, [more]


def _meters(file: Path, content: MotionContent, level: np.ndarray, wanted: MotionFormat) -> tuple[float, list[str]]:
    """Meters per unit. What is said counts more than what a format usually has."""
    if wanted.unit is not None:
        meters = METERS_PER_UNIT[wanted.unit]
        known = content.meters_per_unit
        if content.is_plain and known is not None and known != meters:
            inside = next(name for name, one in METERS_PER_UNIT.items() if one == known)
            raise InputError(
                f"unit of {file}", wanted=f"'{inside}', which the file declares", came=f"'{wanted.unit}'",
                remedy="Leave out --unit.",
            )  # fmt: skip
        return meters, []
    if content.meters_per_unit is not None:
        return content.meters_per_unit, []
    if wanted.hand_length_m is not None:
        return 1.0, []
    meters, more = recognized_unit(level, str(file))
    # plain arrays are documented to be meters
    return meters, [] if content.is_plain and meters == 1.0 else [more]


def _evenly(
    file: Path, content: MotionContent, level_m: np.ndarray, wanted: MotionFormat
) -> tuple[np.ndarray, np.ndarray, float, list[str]]:
    """The frames at an even rate, which of them are filled, the rate, and what was done. Frames that the file leaves
    out are missing. InputError for times too far apart."""
    filled = np.zeros(len(level_m), dtype=bool) if content.filled is None else content.filled
    if wanted.fps is not None:
        return level_m, filled, wanted.fps, []
    times_s, more = clock_s(content.times)
    notes = [more] if more else []
    if times_s is not None:
        even_m, filled, fps, more = _by_clock(file, times_s, level_m, filled)
        return even_m, filled, fps, notes + more
    if content.fps is not None or len(level_m) == 1:
        return level_m, filled, content.fps or DEFAULT_FPS, notes
    notes.append(f"It does not say its frames per second: {DEFAULT_FPS:g} are taken; --fps sets another.")
    return level_m, filled, DEFAULT_FPS, notes


def _by_clock(
    file: Path, times_s: np.ndarray, level_m: np.ndarray, filled: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, list[str]]:
    fps, numbers = even_frames(times_s)
    if not is_one_motion(len(times_s), times_s[-1] - times_s[0], fps):
        steps_s = np.diff(times_s)
        longest = int(np.argmax(steps_s))
        raise InputError(
            f"motion file {file}",
            wanted="times of one motion",
            came=f"{len(times_s)} over {times_s[-1]:g} s, of which {steps_s[longest]:g} s before frame {longest + 1}",
            remedy="--fps NUMBER plays its frames without their times.",
        )
    if numbers is None:
        again, places = retimed(level_m, times_s, fps)
        more = f"Its frames do not come evenly: they were resampled at {fps:.4g} frames per second."
        return again, np.interp(places, np.arange(len(filled)), filled) > FRAME_EPS, fps, [more]
    whole = np.full((numbers[-1] + 1, *level_m.shape[1:]), np.nan)
    whole_filled = np.zeros(len(whole), dtype=bool)
    whole[numbers], whole_filled[numbers] = level_m, filled
    return whole, whole_filled, fps, []
