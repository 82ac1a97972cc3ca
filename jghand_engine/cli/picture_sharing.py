"""Parts of a render: several processes, on one machine or on many, make the pictures of one folder together.

A picture is renamed into place when it is whole, and says in its head what it was made from. A process claims the one
that it is at (`lock.Claims`), so that two that meet do not make it both; a killed one loses that one. A run that makes
all pictures is a part like any other.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jghand_engine.captures.pictures_in import probe_picture
from jghand_engine.cli.console import progress, say
from jghand_engine.cli.picture_stamp import check_stamp
from jghand_engine.errors import InputError
from jghand_engine.limits import CLAIM_WAIT_S
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
        """Whether pictures that this part does not make shall be in the same folder."""
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


def refuse_foreign(shooting: Shooting, part: Part) -> set[int]:
    """InputError when pictures are there that were made from something else, and that would be kept: they would be
    mixed with those of this part. Gives those that are there and were not, which need not be looked at again."""
    total = len(shooting.joints_m)
    if not part.is_shared:
        return set()
    replaced = () if part.skip_existing else part.indices(total)
    return _there(shooting, (index for index in range(total) if index not in replaced))


def make_part(shooting: Shooting, part: Part, known: Collection[int] = ()) -> Outcome:
    """Sees to it that the pictures of a part are there. known: from `refuse_foreign`. InputError when pictures are, at
    the end, that were made from something else: of a shard that began at the same time."""
    total = len(shooting.joints_m)
    indices = part.indices(total)
    outcome = Outcome()
    claims = Claims(shooting.target.folder / CLAIMS)
    left = _left_behind(shooting)
    try:
        with progress(shooting.target.text, len(indices)) as bar:

            def see_to(index: int, left: Mapping[str, list[Path]]) -> bool:
                # where somebody else may be at this picture, nothing of it is cleared away
                of_it = left.get(shooting.target.path(index).stem, []) if claims.sure else []
                made = _see_to(shooting, index, part, outcome, of_it)
                bar.advance(bar.task_ids[0])
                return made

            busy = []
            for index in indices:
                with claims.held(index) as free:
                    if free:
                        see_to(index, left)
                    else:
                        busy.append(index)
            wait_s = CLAIM_WAIT_S
            for index in busy:
                since_s = time.monotonic()
                with claims.held(index, wait_s=wait_s) as free:
                    # drawing is no waiting
                    wait_s -= time.monotonic() - since_s
                    path = shooting.target.path(index)
                    # whoever was at it may have been killed over it
                    made = see_to(index, _left_behind(shooting) if free and not path.exists() else {})
                    if made and not free:
                        say(f"{path.name} was made here too: a process has claimed it and does not finish it.")
        # of this part all are
        others = [index for index in range(total) if index not in indices and index not in known]
        outcome.complete = len(_there(shooting, others)) == len(others)
    finally:
        claims.close()
    return outcome


def _there(shooting: Shooting, indices: Iterable[int]) -> set[int]:
    """Which of these pictures are there, whoever made them. InputError when one was made from something else."""
    paths = ((shooting.target.path(index), index) for index in indices)
    return {index for path, index in paths if path.exists() and check_stamp(path, shooting.stamp(index))}


def _left_behind(shooting: Shooting) -> dict[str, list[Path]]:
    """Stem of a picture -> half-written files of it, which `files.writing` calls .STEM.RANDOM.SUFFIX."""
    found: dict[str, list[Path]] = {}
    folder = shooting.target.folder
    for path in (*folder.glob(".*.*.png"), *folder.glob("passes/.*.*.exr")):
        found.setdefault(path.name[1:].split(".")[0], []).append(path)
    return found


def _see_to(shooting: Shooting, index: int, part: Part, outcome: Outcome, left: Iterable[Path]) -> bool:
    """Makes a claimed picture, or keeps it, and gives whether it was made; what killed processes left of it goes."""
    path = shooting.target.path(index)
    for half in left:
        with contextlib.suppress(OSError):  # on Windows while another program reads it
            half.unlink()
    if part.skip_existing and path.exists():
        if _is_whole(shooting, index):
            outcome.kept += 1
            return False
        outcome.broken += 1
    shooting.make(index)
    outcome.made += 1
    return True


def _is_whole(shooting: Shooting, index: int) -> bool:
    """Whether picture and maps are there, undamaged. InputError when they were made from something else."""
    path, stamp = shooting.target.path(index), shooting.stamp(index)
    if not check_stamp(path, stamp):
        return False
    try:
        probe_picture(path)
    except InputError:
        return False
    return shooting.passes is None or shooting.passes.is_whole(path, stamp)
