# SPDX-License-Identifier: GPL-3.0-or-later
"""What generators that work in turns share: work in a thread that they wait for, one as a part of another, and doing
all turns at once.

Does not use bpy.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from typing import TypeVar

from . import limits

_Result = TypeVar("_Result")


def aside(work: Callable[[], _Result]) -> Generator[float, None, _Result]:
    """Does `work` in a thread; yields 0 every few milliseconds while it lasts, and returns, or raises, what it did.

    Closed half-way it leaves the work to itself: it ends unseen, so it must change nothing that is seen.
    """
    results: list[_Result] = []
    failures: list[BaseException] = []

    def run() -> None:
        try:
            results.append(work())
        except BaseException as failure:  # whoever waits raises it
            failures.append(failure)

    thread = threading.Thread(target=run, daemon=True, name="jghand aside")
    thread.start()
    while True:
        thread.join(limits.ASIDE_LOOK_S)
        if not thread.is_alive():
            break
        yield 0.0
    if failures:
        raise failures[0]
    return results[0]


def part_of(steps: Generator[float, None, _Result], start: float, share: float) -> Generator[float, None, _Result]:
    """Steps that are a `share` of a longer work, of which `start` is done before them."""
    try:
        while True:
            try:
                part = next(steps)
            except StopIteration as end:
                return end.value
            yield start + share * part
    finally:
        steps.close()


def at_once(steps: Generator[float, None, _Result]) -> _Result:
    """All turns of a generator, one after the other; what it returns."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            return end.value
