# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions of other programs, which the engine makes into one of ours: its words, and what it said. Does not use bpy."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path

from ..errors import JGHandFailure
from .motion_files import MotionFile, read_motion

# what this package reads by itself, and what needs the engine
OWN_SUFFIXES = (".npz", ".json", ".csv")
FOREIGN_SUFFIXES = (".npy", ".bvh", ".usd", ".usda", ".usdc", ".usdz")
# orders of joints: the engine's word, and what an artist reads
ORDERS = (
    ("standard", "OpenPose, MediaPipe"),
    ("interhand", "InterHand2.6M"),
    ("mano16_tips", "MANO, Tips at the End"),
    ("openxr", "OpenXR, WebXR"),
    ("level", "Level by Level"),
)
# what the engine advises where only a hand has to be chosen
WANTS_HAND = "--hand right or --hand left"
_MOTION, _FIGURES = "motion.npz", "figures.json"


@dataclass(frozen=True)
class ConversionChoices:
    """What a file may not say of itself, in the command line's own words; "" or 0: it says it, or it is recognized.

    hand: right or left · unit: m, cm or mm · order: of the joints · fps: frames per second · hand_length_mm: from the
    wrist to the middle finger's tip · part: which skeleton, animation or person · in_place: keep the wrist where it is
    up: the axis that points up, y or z · labels: true or mirrored, of a detector · bones: a JSON file with the names of
    bones by joint · mirror: make it the other hand's
    """

    hand: str = ""
    unit: str = ""
    order: str = ""
    fps: float = 0.0
    hand_length_mm: float = 0.0
    part: str = ""
    in_place: bool = False
    up: str = ""
    labels: str = ""
    bones: str = ""
    mirror: bool = False


def words(path: Path, folder: Path, choices: ConversionChoices) -> tuple[str, ...]:
    """`jghand motion`: a motion with z up, as Blender has it, and what was recognized, in `folder`."""
    said = (
        ("--hand", choices.hand),
        ("--unit", choices.unit),
        ("--order", choices.order),
        ("--fps", f"{choices.fps:g}" if choices.fps else ""),
        ("--hand-length", f"{choices.hand_length_mm:g}" if choices.hand_length_mm else ""),
        ("--part", choices.part),
        ("--file-up", choices.up),
        ("--labels", choices.labels),
        ("--bones", choices.bones),
    )
    return (
        *("motion", str(path), "--out", str(folder / _MOTION), "--json", str(folder / _FIGURES), "--up", "z"),
        *(word for option, value in said if value for word in (option, value)),
        *(("--mirror",) if choices.mirror else ()),
        *(("--in-place",) if choices.in_place else ()),
    )


def read_converted(folder: Path) -> MotionFile:
    """The motion that the engine left, with its sentences as notes. JGHandFailure: bad_motion."""
    motion = read_motion(folder / _MOTION)
    try:
        notes = json.loads((folder / _FIGURES).read_text(encoding="utf-8"))["notes"]
        told = tuple(str(note) for note in notes)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise JGHandFailure("bad_motion", f"{folder / _FIGURES}: {error}") from error
    return replace(motion, notes=(*motion.notes, *told))
