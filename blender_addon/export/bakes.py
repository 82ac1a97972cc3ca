# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies in the folder of a bake, what it was made from, and whether that is still so. Does not use bpy.

A hand has a folder of its own, and every bake a generation in it: HAND/v0001, HAND/v0002. The one before is removed
when the new one is finished and plays, so a bake that fails or is canceled loses nothing, and no file that is open is
written to.

NAME.usda and its layers    plays wherever USD is read, no engine and no extension needed
NAME.npz                    the joints, to compare with and to export from again
bake.json                   the stamp, written last: a folder without it holds no finished bake
"""

from __future__ import annotations

import contextlib
import functools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..core import limits
from ..core.files import write_whole
from ..errors import JGHandFailure
from ..hand.motion_files import read_motion
from .recording import Recording, avatar_digest

STAMP = "bake.json"
_FORMAT, _VERSION = "jghand bake", 1
_GENERATION = re.compile(r"v\d{4,}")
_OWN = re.compile(r"bake\.json|.*\.(npz|json|usda|usdc|splat)")


@dataclass(frozen=True)
class BakedHand:
    """One hand of a bake. name: stem of its files · avatar: what `avatar_digest` said · joints_sha256: of what was
    baked · first_frame, frames, fps: of the scene · engine_version · gaussians."""

    name: str
    handedness: str
    avatar: str
    joints_sha256: str
    first_frame: int
    frames: int
    fps: float
    engine_version: str
    gaussians: int

    def stage(self, folder: Path) -> Path:
        """The layer that plays."""
        return folder / f"{self.name}.usda"

    def motion(self, folder: Path) -> Path:
        """The joints."""
        return folder / f"{self.name}.npz"

    def figures(self, folder: Path) -> Path:
        """What the engine said about the export."""
        return folder / f"{self.name}.json"


def hand_folder(parent: Path, name: str, owner: str) -> Path:
    """The folder of a hand's bakes: named after the hand, with a number where somebody else's bakes are there."""
    folder, number = parent / name, 2
    while any(_owner(generation) != owner for generation in _finished(folder)):
        folder, number = parent / f"{name}_{number}", number + 1
    return folder


def new_generation(folder: Path) -> Path:
    """A folder for one bake, made and empty: no other job gets the same. JGHandFailure: cannot_write."""
    number = 1 + max((int(path.name[1:]) for path in _generations(folder)), default=0)
    while True:
        generation = folder / f"v{number:04d}"
        try:
            generation.mkdir(parents=True)
        except FileExistsError:
            number += 1
        except OSError as error:
            raise JGHandFailure("cannot_write", f"{generation}: {error.strerror or error}") from error
        else:
            return generation


def newest(generation: Path, owner: str) -> Path:
    """A bake, or, where it is not there any more, the newest one of the same hand: undo leads back to old ones."""
    if (generation / STAMP).is_file() or not _GENERATION.fullmatch(generation.name):
        return generation
    own = [other for other in _finished(generation.parent) if _owner(other) == owner]
    return own[-1] if own else generation


def remove(generation: Path, owner: str) -> None:
    """Removes the bake of an owner, of others and of other folders nothing. What somebody holds open stays."""
    if _GENERATION.fullmatch(generation.name) and _owner(generation) == owner:
        _empty(generation)


def remove_unfinished(generation: Path) -> None:
    """Removes what a bake that failed or was canceled has left of its generation; a finished one stays."""
    if _GENERATION.fullmatch(generation.name) and not (generation / STAMP).exists():
        _empty(generation)


def _empty(generation: Path) -> None:
    paths = sorted(generation.rglob("*"), key=lambda path: (path.name != STAMP, -len(path.parts)))
    for path in paths:  # the stamp first: half a bake is none
        with contextlib.suppress(OSError):
            if path.is_dir() and not path.is_symlink():
                path.rmdir()
            elif _OWN.fullmatch(path.name):
                path.unlink()
    for folder in (generation, generation.parent):
        with contextlib.suppress(OSError):
            folder.rmdir()  # not while anything is in it


def _generations(folder: Path) -> list[Path]:
    """In their order."""
    with contextlib.suppress(OSError):
        found = [path for path in folder.iterdir() if _GENERATION.fullmatch(path.name)]
        return sorted(found, key=lambda path: int(path.name[1:]))
    return []


def _finished(folder: Path) -> list[Path]:
    return [path for path in _generations(folder) if (path / STAMP).is_file()]


def _owner(generation: Path) -> str:
    """Whose bake it is; "" where that is not known."""
    try:
        return str(_read_stamp(generation).get("owner", ""))
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return ""


def write_stamp(folder: Path, recordings: Sequence[Recording], owner: str = "") -> None:
    """Finishes a bake: reads what the engine did of every hand, and stamps the folder. owner: whose bake it is.

    JGHandFailure: cannot_write, disk_full; internal where the engine wrote another motion than it was given.
    """
    hands = []
    for recording in recordings:
        figures = check_made(folder / f"{recording.name}.json", recording)
        made_from = figures["made_from"]
        hands.append(
            BakedHand(
                name=recording.name,
                handedness=recording.handedness,
                avatar=avatar_digest(recording.avatar),
                joints_sha256=recording.digest,
                first_frame=recording.first_frame,
                frames=len(recording.joints_m),
                fps=recording.fps,
                engine_version=str(made_from.get("engine_version", "")),
                gaussians=int(figures.get("gaussians", 0)),
            )
        )
    content = {"format": _FORMAT, "version": _VERSION, "owner": owner, "hands": [asdict(hand) for hand in hands]}
    write_whole(folder / STAMP, json.dumps(content, indent=1).encode())


def check_made(path: Path, recording: Recording) -> dict[str, Any]:
    """What the engine said of an export or bake that it made of a recording, from its JSON file.

    JGHandFailure (internal) where it was made of another motion.
    """
    figures = _figures(path)
    made_from = figures.get("made_from")
    if not isinstance(made_from, dict) or made_from.get("joints_sha256") != recording.digest:
        raise JGHandFailure("internal", f"{recording.name}: the renderer wrote other joints than it was given")
    return figures


def read_bake(folder: Path) -> list[BakedHand]:
    """The hands of a finished bake. JGHandFailure (no_bake): there is none, or its files are not all there."""
    try:
        content = _read_stamp(folder)
        if content["format"] != _FORMAT or content["version"] != _VERSION:
            raise ValueError(f"format {content['format']!r}, version {content['version']!r}")
        hands = [_hand(entry) for entry in content["hands"]]
    except OSError as error:
        raise JGHandFailure("no_bake", f"{folder}: {error.strerror or error}") from error
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise JGHandFailure("no_bake", f"{folder / STAMP}: {str(error)[:200]}") from error
    for hand in hands:
        if not hand.stage(folder).is_file():
            raise JGHandFailure("no_bake", f"{hand.stage(folder)} is not there")
    return hands


def _read_stamp(folder: Path) -> Any:
    if (folder / STAMP).stat().st_size > limits.STAMP_MAX_BYTES:
        raise ValueError("too large")
    return json.loads((folder / STAMP).read_text(encoding="utf-8"))


def _hand(entry: Mapping[str, Any]) -> BakedHand:
    hand = BakedHand(**{name: kind(entry[name]) for name, kind in _KINDS.items()})
    # the stem becomes a path: it never leaves the folder
    if not hand.name.isidentifier() or not hand.name.isascii():
        raise ValueError(f"name {hand.name[:40]!r}")
    return hand


_KINDS = {
    **dict.fromkeys(("name", "handedness", "avatar", "joints_sha256", "engine_version"), str),
    **dict.fromkeys(("first_frame", "frames", "gaussians"), int),
    "fps": float,
}


def stale_reasons(
    hand: BakedHand, *, recording: Recording | None = None, avatar: str | None = None, engine_version: str | None = None
) -> list[str]:
    """Why a bake does not show what the scene has now, as far as that is given; [] when nothing speaks against it."""
    reasons = []
    if recording is not None:
        if (recording.first_frame, len(recording.joints_m), recording.fps) != (hand.first_frame, hand.frames, hand.fps):
            reasons.append("the frames or the frame rate are others")
        elif recording.digest != hand.joints_sha256:
            reasons.append("the hand moves in another way")
        avatar = recording.avatar
    if avatar is not None and avatar_digest(avatar) != hand.avatar:
        reasons.append("the avatar is another one")
    if engine_version is not None and hand.engine_version and engine_version != hand.engine_version:
        reasons.append("the renderer is of another version")
    return reasons


def moved_at(hand: BakedHand, folder: Path, frame: float, joints_m: np.ndarray) -> bool:
    """Whether the hand is elsewhere now than in the bake. joints_m: (21, 3) in the world, meters, at this frame.

    False where the bake has no such frame, and between frames. JGHandFailure (bad_motion).
    """
    place = round(frame) - hand.first_frame
    if frame != round(frame) or not 0 <= place < hand.frames:
        return False
    motion = hand.motion(folder)
    try:
        baked_m = _joints(motion, motion.stat().st_mtime_ns)
    except OSError as error:
        raise JGHandFailure("no_bake", f"{motion}: {error.strerror or error}") from error
    return bool(np.abs(baked_m[place] - joints_m).max() > limits.BAKE_MOVED_M)


@functools.lru_cache(maxsize=8)
def _joints(motion: Path, _changed_ns: int) -> np.ndarray:
    """The joints of a bake, read once: a panel compares with them whenever it is drawn."""
    return read_motion(motion).joints_m


def _figures(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise JGHandFailure("internal", f"{path}: {error}") from error
    return content if isinstance(content, dict) else {}
