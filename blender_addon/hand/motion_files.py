# SPDX-License-Identifier: GPL-3.0-or-later
"""Motions as this extension and the renderer hand them to each other: `.npz` files that say what they hold.

    joints_m (F, 21, 3) · order "standard" · unit "m" · fps · handedness · filled (F,) and forearm (F, 4) optional

Whatever else there is (other orders, units, formats, gaps) the renderer reads and repairs. Nothing is ever unpickled.
Does not use bpy. Format: DATA 8, `jghand_engine.motion.files`.
"""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.files import write_whole
from ..core.joints import HANDEDNESSES, NAMES, WRIST
from ..core.panel_text import in_blenders_words
from ..errors import JGHandFailure

# an hour at 120 frames a second is 218 MB as numbers of eight bytes
MAX_BYTES = 512 * 2**20
# frames per second that a motion may have: the renderer's bounds
FPS_MIN, FPS_MAX = 0.1, 10_000.0
# by how much the length of a quaternion may miss 1: single precision
_UNIT = 1e-5


@dataclass(frozen=True)
class MotionFile:
    """joints_m: (F, 21, 3) standard order, meters, whole; notes: what was repaired, in sentences; filled: (F,) bool,
    frames that nobody measured, None where none is known; forearm: (F, 4) how it is turned, see
    `posing.forearm_rotations`, None: as the palm carries it."""

    joints_m: np.ndarray
    fps: float
    handedness: str
    notes: tuple[str, ...] = ()
    filled: np.ndarray | None = None
    forearm: np.ndarray | None = None


def read_motion(path: Path) -> MotionFile:
    """The motion in a file. JGHandFailure (bad_motion): absent, damaged, or not as `write_motion` writes it."""
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(member.file_size for member in archive.infolist()) > MAX_BYTES:
                raise ValueError("it is larger than a motion")
        with np.load(path, allow_pickle=False) as content:
            joints = np.asarray(content["joints_m"], dtype=np.float64)
            said = {name: content[name].item() for name in ("order", "unit", "fps", "handedness")}
            filled = content["filled"].astype(bool) if "filled" in content else np.zeros(len(joints), bool)
            forearm = content["forearm"].astype(np.float64) if "forearm" in content else None
            whole = "valid" not in content or content["valid"].all()
        fps = float(said["fps"])
        known = said["order"] == "standard" and said["unit"] == "m" and said["handedness"] in HANDEDNESSES
        if not (known and FPS_MIN <= fps <= FPS_MAX):
            raise ValueError(", ".join(f"{name} {value!r}" for name, value in said.items()))
        if joints.ndim != 3 or joints.shape[1:] != (len(NAMES), 3) or filled.shape != (len(joints),):
            raise ValueError(f"wanted frames x 21 joints x 3, got {joints.shape}")
        if forearm is not None:
            off = np.abs(np.linalg.norm(forearm, axis=-1) - 1)  # NaN is none of less
            if forearm.shape != (len(joints), 4) or not (off < _UNIT).all():
                raise ValueError(f"wanted a quaternion of the forearm for each frame, got {forearm.shape}")
        if not (len(joints) and whole and np.isfinite(joints).all()):
            raise ValueError("frames miss joints")
    except (OSError, ValueError, TypeError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise JGHandFailure("bad_motion", f"{path}: {str(error)[:200]}") from error
    return MotionFile(joints, fps, said["handedness"], (), filled if filled.any() else None, forearm)


def write_motion(path: Path, motion: MotionFile) -> None:
    """Writes `.npz`, everything declared inside; never half-written. JGHandFailure: cannot_write, disk_full."""
    stream = io.BytesIO()
    arrays: dict[str, Any] = {
        "joints_m": np.asarray(motion.joints_m, dtype=np.float64),
        "order": np.array("standard"),
        "unit": np.array("m"),
        "fps": np.array(motion.fps),
        "handedness": np.array(motion.handedness),
        "filled": np.zeros(len(motion.joints_m), bool) if motion.filled is None else motion.filled,
    }
    if motion.forearm is not None:
        arrays["forearm"] = motion.forearm
    np.savez_compressed(stream, **arrays)
    write_whole(path, stream.getvalue())


# ---- what the renderer makes of other programs' files and of videos: its words, and what it left ---------------------

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
    notes = tuple(in_blenders_words(note, MOTION_FIELDS) for note in _figures(folder)["notes"])
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
    motions = []
    for hand in figures["hands"]:
        notes = (*figures["notes"], *filter(None, [_sentence(hand)]))
        motions.append(replace(read_motion(folder / Path(hand["file"]).name), notes=notes))
    width, height = figures["size_px"]
    return TrackedFilm(tuple(motions), (width, height))


def near_hand(motions: Sequence[MotionFile], anchor: int | None, *, in_place: bool) -> list[MotionFile]:
    """Motions of one film brought from before its camera to the origin: there the wrist of motion `anchor` begins, or
    the middle of all wrists. Hands keep their distance; in_place: after that the wrists stay."""
    first = np.array([one.joints_m[0, WRIST] for one in motions])
    center = first.mean(axis=0) if anchor is None else first[anchor]
    moves = [one.joints_m[:, :1] - start if in_place else 0.0 for one, start in zip(motions, first, strict=True)]
    return [replace(one, joints_m=one.joints_m - center - move) for one, move in zip(motions, moves, strict=True)]


def _figures(folder: Path) -> dict[str, Any]:
    return json.loads((folder / _FIGURES).read_text(encoding="utf-8"))


def _sentence(hand: Mapping[str, Any]) -> str:
    """What a user should know of one hand; "" when it was seen all the time."""
    filled, seen = hand["frames_filled"], hand["frames_seen"]
    if not filled:
        return ""
    return (
        f"The {hand['hand']} hand was not seen in {filled} of {filled + seen} frames, which were filled in: their keys "
        "are of the kind Jitter."
    )
