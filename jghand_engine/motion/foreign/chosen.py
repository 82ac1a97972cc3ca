"""Which hand of a file is meant: by what is said, by labels, and by the way in which the fingers bend."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import to_level
from jghand_engine.motion.files import MotionFormat
from jghand_engine.motion.foreign import bvh, gltf, usd
from jghand_engine.motion.foreign.content import HandTrack, MotionContent, named
from jghand_engine.motion.plausibility import curl_towards_palm


def chosen(file: Path, content: MotionContent, wanted: MotionFormat) -> tuple[HandTrack, list[str]]:
    """The hand that is wanted, and the notes so far. InputError where there is none, or more than one."""
    tracks = [track for track in content.tracks if track.frames_seen]
    if not tracks:
        came = "none" if not content.tracks else "hands that are in no frame"
        remedy = content.notes[-1] if content.notes and not content.tracks else ""
        if not content.tracks and content.kind in (bvh.KIND, gltf.KIND, usd.KIND):
            remedy = f"{remedy} Name its bones with --bones.".strip()
        raise InputError(f"motion file {file} ({content.kind})", wanted="a hand of 21 joints", came=came, remedy=remedy)
    if wanted.part is not None:
        tracks = _of_part(file, tracks, wanted.part, content.animations)
    notes = list(content.notes)
    # of one hand alone what the user says counts more than what it looks like
    if wanted.mirrored_labels is None and (len(tracks) > 1 or wanted.handedness is None):
        tracks, said = _relabeled(tracks)
        notes += said
    if wanted.handedness is not None:
        tracks, said = _of_side(file, tracks, wanted.handedness)
        notes += said
    if len(tracks) > 1:
        sides = {track.handedness for track in tracks}
        remedy = "Choose one with --hand right or --hand left." if len(sides) > 1 else "Choose one with --part NAME."
        shown = ", ".join(track.part or "a hand without a name" for track in tracks[:6])
        raise InputError(f"motion file {file}", wanted="one hand", came=f"{len(tracks)}: {shown}"[:300], remedy=remedy)
    return tracks[0], [*notes, *tracks[0].notes]


def _of_side(file: Path, tracks: list[HandTrack], side: Handedness) -> tuple[list[HandTrack], list[str]]:
    """The tracks that are, or may be, the hand of that side."""
    fitting = [track for track in tracks if track.handedness is side]
    if fitting:
        return fitting, []
    unknown = [track for track in tracks if track.handedness is None]
    if unknown:
        return unknown, []
    labeled = [track for track in tracks if track.labeled]
    if len(tracks) == 1 and labeled:
        return labeled, [
            f"Its only hand is labeled {tracks[0].handedness}: it is taken for the {side} one, as was said."
        ]
    raise InputError(
        f"motion file {file}",
        wanted=f"a {side} hand",
        came=f"a {tracks[0].handedness} one only",
        remedy="Say which hand the file has; --mirror makes it the other one afterwards.",
    )


def _of_part(file: Path, tracks: list[HandTrack], part: str, animations: tuple[str, ...]) -> list[HandTrack]:
    """The tracks that a name means; all where it is that of an animation, which was chosen already. InputError."""
    found = named(part, [track.part for track in tracks])
    if found:
        return [tracks[place] for place in found]
    if not named(part, animations):
        known = [name for name in (*(track.part for track in tracks), *animations) if name]
        came = ", ".join(known[:6])[:300] + (", …" if len(known) > 6 else "") if known else "none that has a name"
        raise InputError(f"motion file {file}", wanted=f"a part called {part!r}"[:100], came=came)
    return tracks


def _relabeled(tracks: list[HandTrack]) -> tuple[list[HandTrack], list[str]]:
    """The tracks with their sides by the way in which the fingers bend, where they do: that counts more than a label.
    Sides that would fall together stay."""
    turned, notes = [], []
    for track in tracks:
        side, order = track.handedness, track.order
        if not track.labeled or side is None or order is None:
            turned.append(track)
            continue
        if _bends_as_other(to_level(track.joints, order), side):
            notes.append(
                f"A hand is labeled {side}, but its fingers bend as those of a {side.other} hand: it is taken for one."
            )
            side = side.other
        turned.append(replace(track, handedness=side))
    sides = [[track.handedness for track in some] for some in (tracks, turned)]
    return (turned, notes) if len(set(sides[1])) == len(set(sides[0])) else (tracks, [])


def _bends_as_other(level: np.ndarray, side: Handedness) -> bool:
    """Whether the fingers of (F, 21, 3) level-order joints clearly bend as those of the other hand."""
    # absurd numbers of a damaged file are refused later
    with np.errstate(over="ignore", invalid="ignore"):
        curl = curl_towards_palm(level[:: max(1, len(level) // limits.RECOGNIZE_FRAMES)], side)
    return curl is not None and curl <= -limits.CHECK_CURL


def warned(level: np.ndarray, side: Handedness) -> list[str]:
    """A sentence where fingers bend otherwise than those of the side that was said or stands in names."""
    if not _bends_as_other(level, side):
        return []
    return [f"Its fingers bend as those of a {side.other} hand: either it is one, or its axes are mirrored."]
