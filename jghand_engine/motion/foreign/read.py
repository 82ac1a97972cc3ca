"""Any motion file, of JGHand or of another program, as one hand in meters; and what was recognized on the way.

What a file does not say is recognized where joints can tell it, and told: the unit from the size of the hand, the order
from the lengths of its bones. Which hand it is joints cannot tell: then it has to be said.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, check_hand_size, check_order, to_level
from jghand_engine.hand.sequence import PoseSequence
from jghand_engine.motion import files as motion_files
from jghand_engine.motion.files import MotionFormat
from jghand_engine.motion.foreign import bvh, freemocap, gltf, interhand, mediapipe, openpose, tables, usd, webxr
from jghand_engine.motion.foreign.chosen import chosen, warned
from jghand_engine.motion.foreign.clocks import clock_s, even_frames, is_one_motion
from jghand_engine.motion.foreign.content import HandTrack, MotionContent
from jghand_engine.motion.foreign.damage import told_damage
from jghand_engine.motion.foreign.json_text import JsonText
from jghand_engine.motion.foreign.recognize import Kind, frames_place, kind_of
from jghand_engine.motion.foreign.units import recognized_order, recognized_unit
from jghand_engine.motion.tools import retimed, with_hand_length

_Parsed = TypeVar("_Parsed")
# what files of motions are called; content decides, this is for lists of files
SUFFIXES = (".npz", ".npy", ".json", ".csv", ".bvh", ".glb", ".gltf", *usd.SUFFIXES)


@dataclass(frozen=True)
class MotionRead:
    """A motion, the format it came in, for people, sentences about what was recognized or chosen, the axis that points
    up, "y", "z" or "-y", None where nothing says it, and all files that it was read from."""

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
    order, said = _order(file, track, wanted)
    notes += said
    level = to_level(track.joints, order)
    meters, said = _meters(file, content, level, wanted)
    notes += said
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
    level_m, filled, fps, said = _evenly(file, content, level_m, wanted)
    notes += said
    sequence = PoseSequence(level_m, fps, side, filled=filled)
    if wanted.hand_length_m is not None:
        sequence = with_hand_length(sequence, wanted.hand_length_m)
    if wanted.check_hand and sequence.valid.all(axis=1).any():
        check_hand_size(sequence.joints_m, next((name for name, one in METERS_PER_UNIT.items() if one == meters), "m"))
        check_order(sequence.joints_m, order)
    return MotionRead(sequence, content.kind, tuple(notes), wanted.up or content.up, content.files or (file,))


def read_content(file: Path, wanted: MotionFormat) -> MotionContent:
    """What stands in a file, as it is. InputError, MemoryLimitError."""
    with told_damage(file):
        if file.is_file() and file.stat().st_size > limits.MOTION_MAX_BYTES:
            raise InputError(
                f"motion file {file}",
                wanted=f"at most {limits.MOTION_MAX_BYTES / 2**20:.0f} MiB",
                came=f"{file.stat().st_size / 2**20:.0f} MiB",
                remedy="Cut it into shorter motions.",
            )
        kind = kind_of(file)
        content = _read(file, kind, wanted)
    suffix = file.suffix.lower()
    if suffix in SUFFIXES and file.is_file() and not _fits(suffix, kind):
        note = f"It is called {suffix}, but by its content it is {content.kind}."
        content = replace(content, notes=(note, *content.notes))
    return content


def _read(file: Path, kind: Kind, wanted: MotionFormat) -> MotionContent:
    if kind in (Kind.OWN_NPZ, Kind.OWN_NPY, Kind.OWN_JSON, Kind.OWN_CSV):
        return _own(file, kind)
    if kind is Kind.BVH:
        return bvh.read(file, wanted.bones, wanted.up)
    if kind is Kind.GLTF:
        return gltf.read(file, wanted.fps, wanted.part, wanted.bones)
    if kind is Kind.USD:
        return usd.read(file, wanted.fps, wanted.bones)
    if kind is Kind.OPENPOSE_FOLDER:
        return openpose.read_folder(file)
    if kind is Kind.FREEMOCAP:
        return freemocap.read([file])
    if kind is Kind.FREEMOCAP_FOLDER:
        return freemocap.read(freemocap.files_of(file))
    if kind is Kind.TABLE:
        return tables.read(file)
    return _json(JsonText.of_file(file), kind, wanted)


def _json(text: JsonText, kind: Kind, wanted: MotionFormat) -> MotionContent:
    if kind is Kind.INTERHAND:
        return interhand.read(text)
    members = text.names
    place = frames_place(text)
    frames = text.elements(place) if place is not None else iter([text.value(text.start)])
    fps = text.value(members["fps"]) if "fps" in members else None
    fps = float(fps) if isinstance(fps, int | float) and not isinstance(fps, bool) else None
    if kind is Kind.OPENPOSE:
        return openpose.read(frames)
    if kind is Kind.MEDIAPIPE:
        return mediapipe.read(frames, fps, wanted.mirrored_labels)
    if kind is Kind.IWER:
        return webxr.read_iwer(text.value(members["schema"]), text.elements(members["frames"]))
    return webxr.read(frames, fps)


def _own(file: Path, kind: Kind) -> MotionContent:
    """JGHand's own files, and plain arrays, which say less."""
    content = motion_files.read_content(file, kind.value)
    joints = content.joints
    if not len(joints):
        raise InputError(f"motion file {file}", wanted="at least one frame", came="an empty motion")
    declared = content.declared
    if content.valid is not None:
        if content.valid.shape != joints.shape[:2]:
            raise InputError(f"'valid' in {file}", wanted=f"shape {joints.shape[:2]}", came=str(content.valid.shape))
        joints[~content.valid] = np.nan
    meters = _declared(f"unit of {file}", declared.get("unit"), _meters_of)
    side = _declared(f"handedness of {file}", declared.get("handedness"), Handedness)
    order = _declared(f"order of {file}", declared.get("order"), JointOrder.parse)
    fps = _declared(f"frames per second of {file}", declared.get("fps"), _fps)
    return MotionContent(
        "JGHand's own format" if order is not None and meters is not None else f"plain {kind.value[1:]}",
        (HandTrack(joints, side, order),),
        meters,
        meters is not None,
        fps,
        content.times if fps is None else (),
        filled=motion_files.filled_frames(file, content),
        is_plain=True,
    )


def _declared(thing: str, value: Any, parsed: Callable[[str], _Parsed]) -> _Parsed | None:
    """What a file declares, None for nothing. InputError names the thing."""
    try:
        return None if value is None else parsed(str(value))
    except InputError as error:
        raise InputError(thing, wanted=error.wanted, came=error.came[:200]) from error


def _meters_of(unit: str) -> float:
    if unit not in METERS_PER_UNIT:
        raise InputError("unit", wanted=" or ".join(METERS_PER_UNIT), came=repr(unit))
    return METERS_PER_UNIT[unit]


def _fps(text: str) -> float:
    try:
        fps = float(text)
    except ValueError:
        fps = math.nan
    if not limits.FPS_MIN <= fps <= limits.FPS_MAX:
        wanted = f"{limits.FPS_MIN:g} to {limits.FPS_MAX:g}"
        raise InputError("frames per second", wanted=wanted, came=repr(text))
    return fps


def _fits(suffix: str, kind: Kind) -> bool:
    """Whether a file of a format may be called so."""
    families = {
        ".npz": (Kind.OWN_NPZ,), ".npy": (Kind.OWN_NPY, Kind.FREEMOCAP), ".bvh": (Kind.BVH,),
        ".csv": (Kind.OWN_CSV, Kind.FREEMOCAP, Kind.TABLE), ".glb": (Kind.GLTF,), ".gltf": (Kind.GLTF,),
        ".json": (Kind.OWN_JSON, Kind.OPENPOSE, Kind.MEDIAPIPE, Kind.WEBXR, Kind.IWER, Kind.INTERHAND),
    }  # fmt: skip
    return kind in families.get(suffix, (Kind.USD,))


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
    order, said = recognized_order(track.joints, str(file))
    return order, [said]


def _meters(file: Path, content: MotionContent, level: np.ndarray, wanted: MotionFormat) -> tuple[float, list[str]]:
    """Meters per unit. What is said counts more than what a format usually has."""
    if wanted.unit is not None:
        meters = METERS_PER_UNIT[wanted.unit]
        known = content.meters_per_unit
        if content.declared_unit and known != meters:
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
    meters, said = recognized_unit(level, str(file))
    # plain arrays are documented to be meters
    return meters, [] if content.is_plain and meters == 1.0 else [said]


def _evenly(
    file: Path, content: MotionContent, level_m: np.ndarray, wanted: MotionFormat
) -> tuple[np.ndarray, np.ndarray, float, list[str]]:
    """The frames at an even rate, which of them are filled, the rate, and what was done. Frames that the file leaves
    out are missing. InputError for times too far apart."""
    filled = np.zeros(len(level_m), dtype=bool) if content.filled is None else content.filled
    if wanted.fps is not None:
        return level_m, filled, wanted.fps, []
    times_s, said = clock_s(content.times, content.time_units)
    notes = [said] if said else []
    if times_s is not None:
        even_m, filled, fps, more = _by_clock(file, times_s, level_m, filled)
        return even_m, filled, fps, notes + more
    if content.fps is not None or len(level_m) == 1:
        return level_m, filled, content.fps or limits.DEFAULT_FPS, notes
    notes.append(f"It does not say its frames per second: {limits.DEFAULT_FPS:g} are taken; --fps says otherwise.")
    return level_m, filled, limits.DEFAULT_FPS, notes


def _by_clock(
    file: Path, times_s: np.ndarray, level_m: np.ndarray, filled: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float, list[str]]:
    """`_evenly` for frames at these times."""
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
        said = f"Its frames do not come evenly: they were taken anew at {fps:.4g} frames per second."
        return again, np.interp(places, np.arange(len(filled)), filled) > limits.FRAME_EPS, fps, [said]
    whole = np.full((numbers[-1] + 1, *level_m.shape[1:]), np.nan)
    whole_filled = np.zeros(len(whole), dtype=bool)
    whole[numbers], whole_filled[numbers] = level_m, filled
    return whole, whole_filled, fps, []
