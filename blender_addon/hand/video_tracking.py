# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in a video, which the engine makes into motions: its words, and what it said. Does not use bpy."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..errors import JGHandFailure
from ..renderer.programs import in_terminal
from .motion_files import MotionFile, read_motion

SUFFIXES = (".mp4", ".mov", ".m4v", ".mkv", ".webm", ".avi", ".mpg", ".mpeg", ".mts", ".m2ts", ".ts", ".3gp", ".wmv")
# the engine's option, which its error names where the networks are missing
FETCH = "--fetch-model"
_MOTION, _FIGURES = "motion.npz", "figures.json"


@dataclass(frozen=True)
class TrackingChoices:
    """hand: auto, right, left or both · hand_length_mm: from the wrist to the middle finger's tip, 0: the avatar's ·
    smoothing: 1, more is smoother · camera_angle_deg: angle of view across the longer edge · in_place: the wrist stays
    at the origin · avatar: the hand whose bones the motion is for, "" for the built-in one · fetches:
    whether the engine may download the networks that find a hand, where it has none"""

    hand: str = "auto"
    hand_length_mm: float = 0.0
    smoothing: float = 1.0
    camera_angle_deg: float = 60.0
    in_place: bool = False
    avatar: str = ""
    fetches: bool = False


def words(video: Path, folder: Path, choices: TrackingChoices) -> tuple[str, ...]:
    """`jghand track`: motions with z up, as Blender has it, and what was found, in `folder`."""
    return (
        *("track", str(video), "--out", str(folder / _MOTION), "--json", str(folder / _FIGURES), "--up", "z"),
        *("--hand", choices.hand, "--smoothing", f"{choices.smoothing:g}"),
        *("--camera-angle", f"{choices.camera_angle_deg:g}"),
        *((FETCH,) if choices.fetches else ()),
        *(("--hand-length", f"{choices.hand_length_mm:g}") if choices.hand_length_mm else ()),
        *(("--avatar", choices.avatar) if choices.avatar else ()),
        *(("--in-place",) if choices.in_place else ()),
    )


def fetch_by_hand(failure: JGHandFailure, program: Sequence[str]) -> JGHandFailure:
    """Where the networks that find a hand are missing and may not be downloaded: the command that fetches them. Any
    other failure as it is. program: the words before a verb of the engine's."""
    if FETCH not in failure.detail:
        return failure
    command = in_terminal((*program, "track", "VIDEO", "--out", "motion.npz", FETCH))
    return JGHandFailure("offline", command, log=failure.log)


def read_tracked(folder: Path) -> tuple[MotionFile, ...]:
    """The motions that the engine left, one of each hand; notes say what was filled in. JGHandFailure: bad_motion."""
    path = folder / _FIGURES
    try:
        figures = json.loads(path.read_text(encoding="utf-8"))
        told = tuple(str(note) for note in figures["notes"])
        hands = [(Path(str(hand["file"])).name, _sentence(hand)) for hand in figures["hands"]]
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise JGHandFailure("bad_motion", f"{path}: {error}") from error
    motions = []
    for name, sentence in hands:
        motion = read_motion(folder / name)
        motions.append(replace(motion, notes=(*motion.notes, *told, *((sentence,) if sentence else ()))))
    return tuple(motions)


def _sentence(hand: Mapping[str, Any]) -> str:
    """What a user should know of one hand; "" when it was seen all the time."""
    filled, seen = int(hand["frames_filled"]), int(hand["frames_seen"])
    if not filled:
        return ""
    return (
        f"The {hand['hand']} hand was not seen in {filled} of {filled + seen} frames, which were filled in: their keys "
        "are of the kind Jitter."
    )
