"""Parts of a render: several processes, on one machine or on many, make the pictures of one folder together.

A picture is renamed into place when it is whole, and says in its head what it was made from. A process claims the one
that it is at (`lock.Claims`), so that two that meet do not make it both; a killed one loses that one.
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jghand_engine.cli.console import progress
from jghand_engine.cli.picture_stamp import is_made_from, refuse_foreign
from jghand_engine.datasets.pictures_in import probe_picture
from jghand_engine.errors import InputError
from jghand_engine.lock import Claims

if TYPE_CHECKING:
    from jghand_engine.cli.picture_files import Shooting

CLAIMS = ".jghand.claims"


@dataclass(frozen=True)
class Part:
    """Which pictures a process makes. shard: number from 1, of how many: every so many-th picture · skip_existing:
    whether those that are there already are kept."""

    shard: tuple[int, int] = (1, 1)
    skip_existing: bool = False

    @property
    def is_shared(self) -> bool:
        """Whether other processes may be at work in the same folder."""
        return self.skip_existing or self.shard[1] > 1

    def indices(self, total: int) -> range:
        """The pictures of this part, of `total`."""
        number, count = self.shard
        return range(number - 1, total, count)


@dataclass
class Outcome:
    """What became of a part. made: drawn now · kept: there already · broken: of those that were drawn, how many were
    there, but not whole · complete: whether now all pictures are there, those of the other parts too."""

    made: int = 0
    kept: int = 0
    broken: int = 0
    complete: bool = False

    def sentence(self) -> str:
        parts = [f"{self.made} drawn"]
        if self.kept:
            parts.append(f"{self.kept} there already")
        if self.broken:
            parts.append(f"{self.broken} of the drawn ones were there, but broken")
        return ", ".join(parts) + ("." if self.complete else "; others are still missing.")


def make_part(shooting: Shooting, part: Part) -> Outcome:
    """Sees to it that the pictures of a part are there. InputError, before anything is drawn, when pictures that would
    be kept were made from something else."""
    total = len(shooting.joints_m)
    indices = part.indices(total)
    outcome = Outcome()
    if not part.is_shared:
        shooting.make_all()
        outcome.made, outcome.complete = total, True
        return outcome
    claims = Claims(shooting.target.folder / CLAIMS)
    left = _left_behind(shooting)

    def see_to(index: int) -> None:
        # where the file system has no locks, somebody else may be at this picture: then nothing is cleared away
        _see_to(shooting, index, part, outcome, left if claims.sure else {})

    try:
        with progress(shooting.target.text, len(indices)) as bar:
            busy = []
            for index in indices:
                with claims.held(index) as free:
                    if free:
                        see_to(index)
                        bar.advance(bar.task_ids[0])
                    else:
                        busy.append(index)
            for index in busy:
                # whoever was at it may have been killed over it
                with claims.held(index, wait=True):
                    see_to(index)
                    bar.advance(bar.task_ids[0])
        outcome.complete = all(_is_there(shooting, index) for index in range(total))
    finally:
        # with all pictures there nobody has anything to claim
        claims.close(remove=outcome.complete)
    return outcome


def refuse_foreign_pictures(shooting: Shooting, part: Part) -> None:
    """InputError when one of the pictures that a part would keep was made from something else."""
    if part.skip_existing and shooting.made_from is not None:
        for index in part.indices(len(shooting.joints_m)):
            refuse_foreign(shooting.target.path(index), shooting.made_from.stamp(index))


def _left_behind(shooting: Shooting) -> dict[str, list[Path]]:
    """Stem of a picture -> half-written files of it, which `files.writing` calls .STEM.RANDOM.SUFFIX."""
    found: dict[str, list[Path]] = {}
    folder = shooting.target.folder
    for path in (*folder.glob(".*.*.png"), *folder.glob("passes/.*.*.exr")):
        found.setdefault(path.name[1:].split(".")[0], []).append(path)
    return found


def _see_to(shooting: Shooting, index: int, part: Part, outcome: Outcome, left: dict[str, list[Path]]) -> None:
    """Makes a claimed picture, or keeps it."""
    path = shooting.target.path(index)
    if part.skip_existing and shooting.made_from is not None and path.exists():
        refuse_foreign(path, shooting.made_from.stamp(index))
        if _is_whole(shooting, index):
            outcome.kept += 1
            return
        outcome.broken += 1
    # of a process that was killed: nobody else is at this picture
    for half in left.pop(path.stem, []):
        with contextlib.suppress(OSError):  # on Windows while another program reads it
            half.unlink()
    shooting.make(index)
    outcome.made += 1


def _is_there(shooting: Shooting, index: int) -> bool:
    """Whether a picture of this very render is there, whoever made it."""
    path = shooting.target.path(index)
    return path.exists() and (shooting.made_from is None or is_made_from(path, shooting.made_from.stamp(index)))


def _is_whole(shooting: Shooting, index: int) -> bool:
    path = shooting.target.path(index)
    try:
        probe_picture(path)
    except InputError:
        return False
    if shooting.passes is None or shooting.made_from is None:
        return True
    return shooting.passes.is_whole(path, shooting.made_from.stamp(index))
