# SPDX-License-Identifier: GPL-3.0-or-later
"""A hand over a range of frames, as the scene has it: what is exported and baked. Does not use bpy.

Joints are in the world of the scene, in meters, with z up, as Blender has it.
"""

from __future__ import annotations

import functools
import hashlib
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..core.view import SHIPPED_AVATARS
from ..hand import avatar_files
from ..hand.motion_files import MotionFile, write_motion

# names that Windows keeps for devices, whatever follows after a dot
_RESERVED = {"CON", "PRN", "AUX", "NUL", *(f"{port}{number}" for port in ("COM", "LPT") for number in range(10))}
# how the digest of an avatar ends whose forearm is left out
NO_FOREARM = " no forearm"


# what suits a program: the variant that is shown first, and the size of points; a test compares it with the engine's
USD_PRESETS: dict[str, tuple[str, float]] = {
    "generic": ("splats", 1.0),
    "omniverse": ("splats", 1.0),
    "usdview": ("points_skinned", 2.0),
    "blender": ("points", 2.0),
    "houdini": ("points", 1.0),
}


@dataclass(frozen=True)
class Recording:
    # stem of files, unique among those of one export
    name: str
    handedness: str
    # an absolute path or a shipped name
    avatar: str
    # (F, 21, 3) float64, standard order, meters, in the world, z up
    joints_m: np.ndarray
    # of the scene
    first_frame: int
    fps: float
    # name of the object whose hand it is
    source: str = ""
    forearm: bool = True
    # (F, 4) how it is turned, see `posing.forearm_rotations`; None: as the palm carries it
    forearm_turns: np.ndarray | None = None

    def save(self, path: Path) -> None:
        """Writes a motion file. JGHandFailure: cannot_write, disk_full."""
        write_motion(path, MotionFile(self.joints_m, self.fps, self.handedness, forearm=self.forearm_turns))

    def export_words(self, kind: str, scratch: Path, out: Path, *options: str) -> tuple[str, ...]:
        """Writes the motion into `scratch`; the words of the engine's command line that export it to `out`.

        kind: "usd" for NAME.usda and its layers, "ply" for NAME.0001.ply and so on. JGHandFailure: cannot_write,
        disk_full.
        """
        motion = scratch / f"{self.name}.npz"
        self.save(motion)
        return (
            *("export", kind, "--motion", str(motion), "--avatar", self.avatar, "--out", str(out)),
            *("--name", self.name, "--first-frame", str(self.first_frame), "--up", "z"),
            # the hand that is seen: nothing is repaired on the way
            *("--keep-bone-lengths", "--on-missing", "stop", "--any-proportions"),
            *("--overwrite", *options),
            *([] if self.forearm else ["--no-forearm"]),
        )


def usd_options(variant: str, width_factor: float, radiance: str = "srgb") -> list[str]:
    """Options of `export_words`. variant: what a program shows that cannot choose."""
    return ["--default-variant", variant, "--width-factor", f"{width_factor:g}", "--radiance", radiance]


def file_names(names: Sequence[str]) -> list[str]:
    """Names that file systems and USD accept, for names of objects; those that would be the same get numbers.

    Letters beyond ASCII become a hash of the whole name: two such names are never one, also in exports of another day.
    """
    taken: set[str] = set()
    result = []
    for name in names:
        stem = re.sub(r"\W", "_", name, flags=re.ASCII).strip("_") or "hand"
        stem = f"_{stem}" if stem[0].isdigit() else stem
        if stem.upper() in _RESERVED:
            stem += "_"
        if not name.isascii():
            stem += "_" + hashlib.sha256(name.encode()).hexdigest()[:8]
        chosen, number = stem, 2
        while chosen.casefold() in taken:
            chosen, number = f"{stem}_{number}", number + 1
        taken.add(chosen.casefold())
        result.append(chosen)
    return result


def avatar_digest(avatar: str, *, forearm: bool = True) -> str:
    """What tells avatars apart: SHA-256 of a file, the name of one that the engine brings along; and whether a forearm
    is left out that it has."""
    left_out = NO_FOREARM if not forearm and avatar_files.has_forearm(avatar) else ""
    path = Path(avatar)
    if avatar in SHIPPED_AVATARS or not path.is_file():
        return avatar + left_out
    about = path.stat()
    return _file_digest(path, about.st_mtime_ns, about.st_size) + left_out


@functools.lru_cache(maxsize=32)
def _file_digest(path: Path, _changed_ns: int, _size: int) -> str:
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
