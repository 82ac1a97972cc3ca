"""Repeats a step that the guard wrote down: the same state, the same numbers, the same value that is not finite."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.errors import InputError
from jghand_engine.learn.checkpoint import Stamp, check_stamp, load_checkpoint
from jghand_engine.learn.guard import BEFORE, DESCRIPTION, Finding, find_non_finite
from jghand_engine.learn.snapshot import check_fits
from jghand_engine.learn.trainable import Trainable


@dataclass(frozen=True)
class Replay:
    """What came of it. step: where something was not finite again, None if nothing was · findings: what it was.

    first_time: what was found when it happened, at first_step. Where the two differ, the cause lay outside the
    arithmetic: memory, another process, or a program that has changed since.
    """

    first_step: int
    first_time: list[Finding]
    step: int | None
    findings: list[Finding]


def replay(folder: Path, trainable: Trainable, stamp: Stamp) -> Replay:
    """Runs `trainable` from the good state of a dump up to the step that failed. InputError for a folder that is none,
    or one of other options than `stamp`."""
    try:
        description = json.loads((folder / DESCRIPTION).read_text(encoding="utf-8"))
        first_step, first_time = int(description["step"]), [Finding(**one) for one in description["findings"]]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"{folder}", wanted="a failure that a training has dumped", came=f"{error}"[:200]) from error
    before, options = load_checkpoint(folder / BEFORE)
    check_stamp(options, stamp, str(folder / BEFORE))
    check_fits(before.tensors, trainable, str(folder / BEFORE))
    course = before.restore(trainable)
    for number in range(course.step, first_step + 1):
        if number in course.skipped:
            continue
        if findings := find_non_finite(trainable.step(number), trainable):
            return Replay(first_step, first_time, number, findings)
    return Replay(first_step, first_time, None, [])
