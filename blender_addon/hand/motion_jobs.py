# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions that the renderer makes for us, of other programs' files and of videos: its words, and what it left.

Does not use bpy.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from ..errors import JGHandFailure
from .motion_files import MotionFile, read_motion

# what Import Motion reads; that of jghand itself first
MOTION_SUFFIXES = (".npz", ".json", ".csv", ".npy", ".bvh", ".usd", ".usda", ".usdc", ".usdz")
VIDEO_SUFFIXES = (
    *(".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg"),
    *(".mts", ".m2ts", ".ts", ".3gp", ".wmv"),
)
# orders of joints: the renderer's word, and what an artist reads
ORDERS = (
    ("standard", "OpenPose, MediaPipe"),
    ("interhand", "InterHand2.6M"),
    ("mano16_tips", "MANO, Tips at the End"),
    ("openxr", "OpenXR, WebXR"),
    ("level", "Level by Level"),
)
# what the renderer advises where only a hand has to be chosen, and where the networks that find a hand are missing
WANTS_HAND, FETCH = "--hand right or --hand left", "--fetch-model"
_MOTION, _FIGURES = "motion.npz", "figures.json"


def words(verb: str, path: Path, folder: Path, options: Mapping[str, str | bool]) -> tuple[str, ...]:
    """`jghand motion` or `jghand track`: motions with z up, as Blender has it, and what was recognized, in `folder`.

    options: of the verb, "" or False where nothing is to be said.
    """
    said = [
        word for option, value in options.items() if value for word in ((option,) if value is True else (option, value))
    ]
    return (verb, str(path), "--out", str(folder / _MOTION), "--json", str(folder / _FIGURES), "--up", "z", *said)


def read_converted(folder: Path) -> MotionFile:
    """The motion that the renderer left, with its sentences as notes. JGHandFailure: bad_motion."""
    figures = _figures(folder)
    return replace(read_motion(folder / _MOTION), notes=_notes(folder, figures))


def read_tracked(folder: Path) -> tuple[MotionFile, ...]:
    """The motions that the renderer left, one of each hand; notes say what was filled in. JGHandFailure: bad_motion."""
    figures = _figures(folder)
    notes = _notes(folder, figures)
    try:
        hands = [(Path(str(hand["file"])).name, _sentence(hand)) for hand in figures["hands"]]
    except (ValueError, KeyError, TypeError) as error:
        raise JGHandFailure("bad_motion", f"{folder / _FIGURES}: {error}") from error
    return tuple(replace(read_motion(folder / name), notes=(*notes, *filter(None, [text]))) for name, text in hands)


def _figures(folder: Path) -> dict[str, Any]:
    try:
        figures = json.loads((folder / _FIGURES).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise JGHandFailure("bad_motion", f"{folder / _FIGURES}: {error}") from error
    if not isinstance(figures, dict):
        raise JGHandFailure("bad_motion", f"{folder / _FIGURES}: no figures")
    return figures


def _notes(folder: Path, figures: Mapping[str, Any]) -> tuple[str, ...]:
    notes = figures.get("notes")
    if not isinstance(notes, list):
        raise JGHandFailure("bad_motion", f"{folder / _FIGURES}: no notes")
    return tuple(map(str, notes))


def _sentence(hand: Mapping[str, Any]) -> str:
    """What a user should know of one hand; "" when it was seen all the time."""
    filled, seen = int(hand["frames_filled"]), int(hand["frames_seen"])
    if not filled:
        return ""
    return (
        f"The {hand['hand']} hand was not seen in {filled} of {filled + seen} frames, which were filled in: their keys "
        "are of the kind Jitter."
    )
