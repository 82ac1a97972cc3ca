"""The guard: the first value that is not finite is found within the step in which it appears, written down, and undone.

Every step one fused check reads all gradients and the whole state; only when it sees something are the tensors looked
at one by one. The last good state is a copy in memory, at most GUARD_KEEP_STEPS old: the training goes back to it and
leaves out the step that failed. What was found is dumped with that copy, so that `replay` can run into it again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path

import safetensors.torch
import torch

from jghand_engine.errors import InputError, JGHandError
from jghand_engine.files import writing
from jghand_engine.learn.checkpoint import Snapshot, Stamp, check_fits, check_stamp, load_checkpoint, save_checkpoint
from jghand_engine.learn.trainable import Trainable

# steps between two copies of the state in memory, to which the guard goes back: a copy costs a few milliseconds
GUARD_KEEP_STEPS = 50
# values that are not finite after which a training gives up: one or two happen, more are a fault of the model
GUARD_RECOVERIES_MAX = 5

BEFORE, FOUND, DESCRIPTION = "before.safetensors", "found.safetensors", "failure.json"


@dataclass(frozen=True)
class Finding:
    """Something that is not finite. kind: figure, gradient or state · name · nan, inf: how many values of it are."""

    kind: str
    name: str
    nan: int
    inf: int

    def __str__(self) -> str:
        parts = [f"{count} {what}" for count, what in ((self.nan, "NaN"), (self.inf, "infinite")) if count]
        return f"{self.kind} {self.name} ({', '.join(parts)})"


def find_non_finite(figures: Mapping[str, float], trainable: Trainable) -> list[Finding]:
    """What a step left that is not finite, in the order in which it computes: its figures, gradients, state.

    Costs one pass over memory when there is nothing.
    """
    bad = [
        Finding("figure", name, int(math.isnan(value)), int(math.isinf(value)))
        for name, value in figures.items()
        if not math.isfinite(value)
    ]
    parts = {"gradient": trainable.gradients(), "state": trainable.tensors()}
    floating = [tensor for part in parts.values() for tensor in part.values() if tensor.is_floating_point()]
    # the norm overflows for huge finite values too: then the exact look finds nothing
    if bad or not math.isfinite(float(torch.nn.utils.get_total_norm(floating))):
        bad += [finding for kind, part in parts.items() for finding in _in_tensors(kind, part)]
    return bad


def _in_tensors(kind: str, tensors: Mapping[str, torch.Tensor]) -> list[Finding]:
    counts = ((name, int(tensor.isnan().sum()), int(tensor.isinf().sum())) for name, tensor in tensors.items())
    return [Finding(kind, name, nan, inf) for name, nan, inf in counts if nan or inf]


class Guard:
    """Keeps the last good state of a training, and goes back to it."""

    def __init__(self, folder: Path, stamp: Stamp) -> None:
        """folder: where failures are dumped, one folder each · stamp: the options, written into the dumps."""
        self._folder, self._stamp = folder, stamp
        self._good: Snapshot | None = None

    def keep(self, snapshot: Snapshot) -> None:
        self._good = snapshot

    def recover(self, number: int, findings: list[Finding], trainable: Trainable) -> tuple[Snapshot, Path]:
        """Dumps the failed step `number` and puts `trainable` back; returns the state it has now, and the dump.

        The returned state leaves the step out. JGHandError when that happened too often.
        """
        if self._good is None:
            raise RuntimeError("the guard was given no state to go back to")
        dump = write_dump(
            self._folder / f"step_{number:08d}", Failure(number, findings, self._good, self._stamp), trainable
        )
        course = self._good.restore(trainable)
        course.skipped = sorted({*course.skipped, number})
        course.recoveries += 1
        if course.recoveries > GUARD_RECOVERIES_MAX:
            raise JGHandError(
                f"the training gave values that are not finite {course.recoveries} times, "
                f"at last in step {number}: {findings[0]}",
                remedy=f"{dump} holds what is needed to repeat the step (--replay). A lower learning rate may help.",
            )
        self._good = Snapshot(self._good.tensors, self._good.scalars, course)
        return self._good, dump


# ---- dumps -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Failure:
    """A step that failed. before: the last good state, of the step before or some steps earlier."""

    number: int
    findings: list[Finding]
    before: Snapshot
    stamp: Stamp


def write_dump(folder: Path, failure: Failure, trainable: Trainable) -> Path:
    """Writes the state before (a checkpoint), tensors and gradients as they were found, and a description as JSON."""
    save_checkpoint(folder / BEFORE, failure.before, failure.stamp)
    found = {f"state.{name}": tensor for name, tensor in trainable.tensors().items()}
    found |= {f"gradient.{name}": tensor for name, tensor in trainable.gradients().items()}
    copies = {name: tensor.detach().cpu().clone().contiguous() for name, tensor in found.items()}
    with writing(folder / FOUND) as temporary:
        temporary.write_bytes(safetensors.torch.save(copies))
    description = {
        "step": failure.number,
        "good_step": failure.before.course.step,
        "stamp": dict(failure.stamp),
        "findings": [asdict(finding) for finding in failure.findings],
    }
    with writing(folder / DESCRIPTION) as temporary:
        temporary.write_text(json.dumps(description, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return folder


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
