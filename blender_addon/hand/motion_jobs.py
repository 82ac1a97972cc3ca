# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions that the renderer makes for us, of other programs' files and of videos: its words, and what it left.

Does not use bpy.
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.joints import WRIST
from ..core.panel_text import in_blenders_words
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
# what the renderer calls its options -> the field of Import Motion, and of Track Video
MOTION_FIELDS = {
    **{"--hand": "Hand", "--hand-length": "Hand Length", "--unit": "Unit", "--order": "Order", "--fps": "Frame Rate"},
    **{"--part": "Part", "--bones": "Bone Names", "--labels": "Labels", "--file-up": "Up", "--mirror": "Mirror"},
}
VIDEO_FIELDS = {
    **{"--hand": "Hands", "--hand-length": "Hand Length"},
    **{"--camera-angle": "Camera Angle", "--smoothing": "Smoothing", "--exact": "Exact"},
}


def words(verb: str, path: Path, folder: Path, options: Mapping[str, str | bool]) -> tuple[str, ...]:
    """`jghand motion` or `jghand track`: motions with z up, as Blender has it, and what was recognized, in `folder`.

    options: of the verb, "" or False where nothing is to be said.
    """
    places = ("--out", str(folder / _MOTION), "--json", str(folder / _FIGURES))
    return (verb, str(path), *places, "--up", "z", *option_words(options))


def option_words(options: Mapping[str, str | bool]) -> Iterator[str]:
    """Options of a command line, but those that are "" or False."""
    for option, value in options.items():
        if value:
            yield from (option,) if value is True else (option, value)


def read_converted(folder: Path) -> MotionFile:
    """The motion that the renderer left, with its sentences as notes. JGHandFailure: bad_motion."""
    figures = _figures(folder)
    notes = tuple(in_blenders_words(note, MOTION_FIELDS) for note in _notes(folder, figures))
    return replace(read_motion(folder / _MOTION), notes=notes)


@dataclass(frozen=True)
class TrackedFilm:
    """What was found in a video. motions: one of each hand, before the camera, which is the origin and looks along y;
    their notes say what was filled in · size_px: width and height of the video."""

    motions: tuple[MotionFile, ...]
    size_px: tuple[int, int]


def read_tracked(folder: Path) -> TrackedFilm:
    """What the renderer left of a video. JGHandFailure: bad_motion."""
    figures = _figures(folder)
    notes = _notes(folder, figures)
    try:
        hands = [(Path(str(hand["file"])).name, _sentence(hand)) for hand in figures["hands"]]
        width, height = map(int, figures["size_px"])
    except (ValueError, KeyError, TypeError) as error:
        raise JGHandFailure("bad_motion", f"{folder / _FIGURES}: {error}") from error
    motions = [replace(read_motion(folder / name), notes=(*notes, *filter(None, [text]))) for name, text in hands]
    return TrackedFilm(tuple(motions), (width, height))


def near_hand(motions: Sequence[MotionFile], anchor: int | None, *, in_place: bool) -> list[MotionFile]:
    """Motions of one film brought from before its camera to the origin: there the wrist of motion `anchor` begins, or
    the middle of all wrists. Hands keep their distance; in_place: after that the wrists stay."""
    first = np.array([one.joints_m[0, WRIST] for one in motions])
    center = first.mean(axis=0) if anchor is None else first[anchor]
    moves = [one.joints_m[:, :1] - start if in_place else 0.0 for one, start in zip(motions, first, strict=True)]
    return [replace(one, joints_m=one.joints_m - center - move) for one, move in zip(motions, moves, strict=True)]


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
