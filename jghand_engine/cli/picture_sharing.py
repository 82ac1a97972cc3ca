"""Parts of a render: several processes, on one machine or on many, make the pictures of one folder together.

A picture is renamed into place when it is whole, and says in its head what it was made from. A process claims the one
that it is at (`lock.Claims`), so that two that meet do not make it both; a killed one loses that one. A run that makes
all pictures is a part like any other.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from jghand_engine.cli.console import progress, say
from jghand_engine.cli.picture_stamp import is_made_from
from jghand_engine.datasets.pictures_in import probe_picture
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


def make_part(shooting: Shooting, part: Part) -> Outcome:
    """Sees to it that the pictures of a part are there. InputError when pictures are, at the end, that were made from
    something else: of a shard that began at the same time."""
    total = len(shooting.joints_m)
    indices = part.indices(total)
    outcome = Outcome()
    claims = Claims(shooting.target.folder / CLAIMS)
    left = _left_behind(shooting)
    try:
        with progress(shooting.target.text, len(indices)) as bar:

            def see_to(index: int, left: Mapping[str, list[Path]]) -> None:
                # where somebody else may be at this picture, nothing of it is cleared away
                of_it = left.get(shooting.target.path(index).stem, []) if claims.sure else []
                _see_to(shooting, index, part, outcome, of_it)
                bar.advance(bar.task_ids[0])

            busy = []
            for index in indices:
                with claims.held(index) as free:
                    if free:
                        see_to(index, left)
                    else:
                        busy.append(index)
            until_s = time.monotonic() + CLAIM_WAIT_S
            for index in busy:
                # whoever was at it may have been killed over it
                with claims.held(index, wait_s=until_s - time.monotonic()) as free:
                    if not free:
                        name = shooting.target.path(index).name
                        say(f"{name} is claimed by a process that does not finish it: it is made here too.")
                    see_to(index, _left_behind(shooting) if free else {})
        outcome.complete = _all_there(shooting, range(total))
    finally:
        # with all pictures there, or in a folder of one's own, nobody has anything to claim
        claims.close(remove=outcome.complete or not part.is_shared)
    return outcome


def refuse_foreign_pictures(shooting: Shooting, part: Part) -> None:
    """InputError when pictures are there that were made from something else, and that would be kept: they would be
    mixed with those of this part."""
    total = len(shooting.joints_m)
    if part.is_shared:
        replaced = () if part.skip_existing else part.indices(total)
        _all_there(shooting, (index for index in range(total) if index not in replaced))


def _all_there(shooting: Shooting, indices: Iterable[int]) -> bool:
    """Whether these pictures are there, whoever made them. InputError when one was made from something else."""
    paths = ((shooting.target.path(index), index) for index in indices)
    if shooting.made_from is None:
        return all(path.exists() for path, _ in paths)
    # all of them are looked at, also when one is missing
    found = [is_made_from(path, shooting.made_from.stamp(index)) for path, index in paths]
    return all(found)


def _left_behind(shooting: Shooting) -> dict[str, list[Path]]:
    """Stem of a picture -> half-written files of it, which `files.writing` calls .STEM.RANDOM.SUFFIX."""
    found: dict[str, list[Path]] = {}
    folder = shooting.target.folder
    for path in (*folder.glob(".*.*.png"), *folder.glob("passes/.*.*.exr")):
        found.setdefault(path.name[1:].split(".")[0], []).append(path)
    return found


def _see_to(shooting: Shooting, index: int, part: Part, outcome: Outcome, left: Iterable[Path]) -> None:
    """Makes a claimed picture, or keeps it; what killed processes left of it goes."""
    path = shooting.target.path(index)
    for half in left:
        with contextlib.suppress(OSError):  # on Windows while another program reads it
            half.unlink()
    if part.skip_existing and path.exists():
        if _is_whole(shooting, index):
            outcome.kept += 1
            return
        outcome.broken += 1
    shooting.make(index)
    outcome.made += 1


def _is_whole(shooting: Shooting, index: int) -> bool:
    """Whether picture and maps are there, undamaged. InputError when they were made from something else."""
    path = shooting.target.path(index)
    stamp = None if shooting.made_from is None else shooting.made_from.stamp(index)
    if stamp is not None and not is_made_from(path, stamp):
        return False
    try:
        probe_picture(path)
    except InputError:
        return False
    return shooting.passes is None or stamp is None or shooting.passes.is_whole(path, stamp)
