"""Which hand of a file is meant, and its unit and joint order: by what is said, by labels, and by the hand itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import JOINT_COUNT, Handedness
from jghand_engine.hand.orders import (
    HAND_LENGTH_MAX_M,
    HAND_LENGTH_MIN_M,
    METERS_PER_UNIT,
    JointOrder,
    check_joint_shape,
    guess_order,
    hand_length,
    to_level,
)
from jghand_engine.hand.rotations import unit
from jghand_engine.motion.content import HandTrack, MotionContent, MotionFormat

# frames in which joint order and the bend of the fingers are looked for: a hand's bones do not change
_FRAMES = 500
# mean bend of the fingers' middle joints away from the palm, as a sine, from which it must be the other hand
CURL_MIN = 0.1
# joints of index..pinky in level order
_MCP, _PIP, _DIP = slice(2, 6), slice(7, 11), slice(12, 16)
_UNIT_NAMES = {"m": "meters", "cm": "centimeters", "mm": "millimeters"}


def chosen(file: Path, content: MotionContent, wanted: MotionFormat) -> tuple[HandTrack, list[str]]:
    """The hand that is wanted, and the notes so far. InputError where there is none, or more than one."""
    tracks = [track for track in content.tracks if np.isfinite(track.joints).all(axis=-1).any()]
    if not tracks:
        came = "none" if not content.tracks else "hands that are in no frame"
        remedy = content.notes[-1] if content.notes and not content.tracks else ""
        raise InputError(f"motion file {file} ({content.kind})", wanted="a hand of 21 joints", came=came, remedy=remedy)
    if wanted.part is not None:
        tracks = _of_part(file, tracks, wanted.part)
    notes = list(content.notes)
    # of one hand alone what the user says counts more than what it looks like
    if wanted.mirrored_labels is None and (len(tracks) > 1 or wanted.handedness is None):
        tracks, more = _relabeled(tracks)
        notes += more
    if wanted.handedness is not None:
        tracks, more = _of_side(file, tracks, wanted.handedness)
        notes += more
    if len(tracks) > 1:
        sides = {track.handedness for track in tracks}
        remedy = "Choose one with --hand right or --hand left." if len(sides) > 1 else "Choose one with --part NAME."
        shown = ", ".join(track.part or "a hand without a name" for track in tracks[:6])
        raise InputError(f"motion file {file}", wanted="one hand", came=f"{len(tracks)}: {shown}"[:300], remedy=remedy)
    return tracks[0], [*notes, *tracks[0].notes]


def named(part: str, names: Sequence[str]) -> list[int]:
    """The places of the names that people mean by `part`: those that it is, up to a comma; else those it is part of."""
    wanted = part.casefold().strip()
    known = [name.casefold() for name in names]
    exact = [place for place, name in enumerate(known) if f"{name},".startswith(f"{wanted},")]
    return exact or [place for place, name in enumerate(known) if wanted in name]


def warned(level: np.ndarray, side: Handedness) -> list[str]:
    """A sentence where fingers bend otherwise than those of the side that was said or stands in names."""
    if not _bends_as_other(level, side):
        return []
    return [f"Its fingers bend as those of a {side.other} hand: either it is one, or its axes are mirrored."]


def recognized_order(joints: np.ndarray, source: str) -> tuple[JointOrder, str]:
    """The order in which (F, n, 3) joints look like a hand, and a sentence. InputError when they look like none."""
    count = joints.shape[-2]
    if count in (25, 26):
        return JointOrder.OPENXR, f"{count} joints are taken for those of OpenXR; --order sets another."
    if count != JOINT_COUNT:
        check_joint_shape(joints, JointOrder.STANDARD)
    whole = joints[np.isfinite(joints).all(axis=(1, 2))]
    some = whole[:: max(1, len(whole) // _FRAMES)]
    likely = guess_order(some) if len(some) else None
    if likely is None:
        raise InputError(
            f"joint order of {source}",
            wanted="joints whose bone lengths tell their order",
            came="joints that look like no order that JGHand knows" if len(some) else "no frame with all joints",
            remedy="Say the order with --order, and --any-proportions for a hand of odd proportions.",
        )
    return (
        likely,
        f"Its joint order is not declared: by its bones' lengths it is '{likely}'; --order sets another.",
    )


def recognized_unit(level_joints: np.ndarray, source: str) -> tuple[float, str]:
    """Meters per unit of (F, 21, 3) level-order joints, and a sentence. InputError when no unit makes it a hand."""
    length = hand_length(level_joints)
    for name, meters in METERS_PER_UNIT.items():
        if HAND_LENGTH_MIN_M <= length * meters <= HAND_LENGTH_MAX_M:
            return meters, (
                f"Its unit is not declared: {length:.3g} from the wrist to the middle finger's tip look like "
                f"{_UNIT_NAMES[name]}; --unit sets another."
            )
    raise InputError(
        f"unit of {source}",
        wanted="a hand of 60 to 400 mm in meters, centimeters or millimeters",
        came=f"{length:.4g} from the wrist to the middle finger's tip",
        remedy="Say how long the hand is with jghand motion --hand-length, in millimeters (180 is usual).",
    )


def _of_side(file: Path, tracks: list[HandTrack], side: Handedness) -> tuple[list[HandTrack], list[str]]:
    """The tracks that are, or may be, the hand of that side."""
    for fitting in (side, None):
        of_side = [track for track in tracks if track.handedness is fitting]
        if of_side:
            return of_side, []
    if len(tracks) == 1 and tracks[0].labeled:
        return tracks, [f"Its only hand is labeled {side.other}: it is taken for the {side} one, as requested."]
    raise InputError(
        f"motion file {file}",
        wanted=f"a {side} hand",
        came=f"a {side.other} one only",
        remedy="Say which hand the file has; jghand motion --mirror makes it the other one afterwards.",
    )


def _of_part(file: Path, tracks: list[HandTrack], part: str) -> list[HandTrack]:
    names = [track.part for track in tracks]
    found = named(part, names)
    if not found:
        came = ", ".join(name for name in names[:6] if name)[:300] or "none that has a name"
        raise InputError(f"motion file {file}", wanted=f"a part called {part!r}"[:100], came=came)
    return [tracks[place] for place in found]


def _relabeled(tracks: list[HandTrack]) -> tuple[list[HandTrack], list[str]]:
    """The tracks with their sides by the way in which the fingers bend, where they do: that counts more than a label.
    Sides that would fall together stay."""
    turned, notes = [], []
    for track in tracks:
        side, order = track.handedness, track.order
        if track.labeled and side and order and _bends_as_other(to_level(track.joints, order), side):
            notes.append(
                f"A hand is labeled {side}, but its fingers bend as those of a {side.other} hand: it is taken for one."
            )
            side = side.other
        turned.append(replace(track, handedness=side))
    count, labels = (len({track.handedness for track in some}) for some in (turned, tracks))
    return (turned, notes) if count == labels else (tracks, [])


def _bends_as_other(level: np.ndarray, side: Handedness) -> bool:
    """Whether the fingers of (F, 21, 3) level-order joints clearly bend as those of the other hand."""
    # absurd numbers of a damaged file are refused later
    with np.errstate(over="ignore", invalid="ignore"):
        curl = curl_towards_palm(level[:: max(1, len(level) // _FRAMES)], side)
    return curl is not None and curl <= -CURL_MIN


def curl_towards_palm(joints_m: np.ndarray, handedness: Handedness) -> float | None:
    """Mean bend of index..pinky at the middle joint towards the palm, as a sine, -1..1; None without a whole pose.

    joints_m: (P, 21, 3) level order. These joints bend one way only, about the line of the knuckles, so that a clearly
    negative value is the other hand.
    """
    whole = joints_m[np.isfinite(joints_m).all(axis=(1, 2))]
    if not len(whole):
        return None
    knuckles = unit(whole[:, 2] - whole[:, 5])
    knuckles = knuckles if handedness is Handedness.RIGHT else -knuckles
    proximal, middle = (unit(whole[:, end] - whole[:, start]) for start, end in ((_MCP, _PIP), (_PIP, _DIP)))
    return float((np.cross(proximal, middle) * knuckles[:, None]).sum(axis=-1).mean())
