"""Parts of a capture that several processes make at once: no two may make the same picture."""

from __future__ import annotations

import contextlib
import math
import re
import time
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.errors import RetryError
from jghand_engine.files import make_folder
from jghand_engine.lock import locked

# waiting for another process that is just taking its shard or writing the plan, seconds: it needs milliseconds, or a
# few seconds on a slow disk
LOCK_WAIT_S = 30.0

_NAME = re.compile(r"shard_(\d+)_of_(\d+)\.lock")
_REMEDY = "Wait until it has ended, or take a shard that has no picture in common with it, of the same count."


def overlapping(one: tuple[int, int], other: tuple[int, int]) -> bool:
    """Whether two shards (number from 1, count) can have a pose in common: every count-th pose from number on."""
    return (one[0] - other[0]) % math.gcd(one[1], other[1]) == 0


@contextlib.contextmanager
def shard_locked(folder: Path, shard: tuple[int, int]) -> Iterator[None]:
    """Holds a shard of the capture whose plan is in `folder`. RetryError while another process makes any of its
    pictures, as this shard or as one of another count."""
    with contextlib.ExitStack() as held:
        # one after the other, or two could look for each other before either has its lock
        with alone(folder):
            held.enter_context(_locked(folder, shard))
            for file in sorted(folder.glob("shard_*_of_*.lock")):
                if match := _NAME.fullmatch(file.name):
                    other = int(match[1]), int(match[2])
                    if other != shard and overlapping(shard, other):
                        with _locked(folder, other):
                            pass
        yield


def _locked(folder: Path, shard: tuple[int, int]) -> contextlib.AbstractContextManager[None]:
    number, count = shard
    file = folder / f"shard_{number}_of_{count}.lock"
    return locked(file, work=f"capture of shard {number}/{count}", remedy=_REMEDY)


@contextlib.contextmanager
def alone(folder: Path) -> Iterator[None]:
    """Holds the lock under which the plan and the annotations are written and shards are taken. Others hold it for
    moments only, and are waited for; RetryError after LOCK_WAIT_S. folder: of the plan, made where it is not.
    """
    make_folder(folder)
    until_s = time.monotonic() + LOCK_WAIT_S
    with contextlib.ExitStack() as held:
        while True:
            try:
                held.enter_context(locked(folder / "shards.lock", work="start of a capture"))
                break
            except RetryError:
                if time.monotonic() > until_s:
                    raise
                time.sleep(LOCK_WAIT_S / 600)
        yield
