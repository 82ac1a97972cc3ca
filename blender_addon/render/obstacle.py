# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps a program from writing certain files for a while: a folder stands where the file would be.

Writing over a folder fails on every system, whoever asks for it, and the program that tries says so. A file that is
there already is put aside and comes back. Does not use bpy.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

_ASIDE = ".jghand_aside"


@dataclass(frozen=True)
class Obstacle:
    """path: where nothing can be written · aside: the file that was there, None where there was none · made: folders
    above it that were made for it, the lowest first"""

    path: Path
    aside: Path | None
    made: tuple[Path, ...]

    @property
    def stands(self) -> bool:
        """Whether it still keeps everybody from writing."""
        return self.path.is_dir()


def put(paths: Iterable[Path]) -> list[Obstacle]:
    """Obstacles at all of these paths that are no folders anyway. Where none can be put there is none."""
    obstacles = []
    for path in dict.fromkeys(paths):
        with contextlib.suppress(OSError):
            if not path.is_dir():
                obstacles.append(_put(path))
    return obstacles


def take_away(obstacles: Sequence[Obstacle]) -> None:
    """Everything is as it was before, as far as the system allows it."""
    for obstacle in reversed(obstacles):  # folders were made for the first of them
        with contextlib.suppress(OSError):
            obstacle.path.rmdir()
        if obstacle.aside is not None:
            with contextlib.suppress(OSError):
                obstacle.aside.rename(obstacle.path)
        for folder in obstacle.made:
            with contextlib.suppress(OSError):
                folder.rmdir()


def _put(path: Path) -> Obstacle:
    """OSError where it cannot be put; then nothing was changed."""
    missing = []
    for folder in path.parents:
        if folder.exists():
            break
        missing.append(folder)
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = None
    if path.exists():
        aside = path.with_name(path.name + _ASIDE)
        path.rename(aside)
    try:
        path.mkdir()
    except OSError:
        if aside is not None:
            aside.rename(path)
        raise
    return Obstacle(path, aside, tuple(missing))
