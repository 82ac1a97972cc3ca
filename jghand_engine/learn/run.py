"""The training loop: steps, and between them the log, checkpoints, previews, and what a stop or a fault asks for.

with a lock on the folder, a new or resumed state
    until the budget is spent or somebody stops it
        one step; the guard looks at it
        now and then: a copy for the guard, a line of the log, a checkpoint, a preview
the finished avatar
"""

from __future__ import annotations

import copy
import json
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from jghand_engine.avatar.file import save_avatar
from jghand_engine.color import to_bytes
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import write_png
from jghand_engine.files import file_error, write_file
from jghand_engine.learn.checkpoint import LoopState, Snapshot, Stamp, check_fits
from jghand_engine.learn.fist import with_fist
from jghand_engine.learn.guard import GUARD_KEEP_STEPS, GUARD_KEEPS_AT_FIRST, find_non_finite, recovered
from jghand_engine.learn.progress import Display, Silent, Status
from jghand_engine.learn.schedule import Budget, Every, Timer, stop_requests
from jghand_engine.learn.trainable import GAUSSIANS, LOSS, Trainable
from jghand_engine.learn.work_folder import Start, WorkFolder, check_folder, check_output, write_output

# seconds between two checkpoints: what kill -9 may lose. Writing one of 40 MB takes some 40 ms
CHECKPOINTS = Every(seconds=60.0)
# the first preview is promised within a minute
PREVIEWS = Every(seconds=180.0, first_s=15.0)
# steps that one line of the log averages
LOG_EVERY_STEPS = 20
# of the values that are not finite, so many are named
FINDINGS_NAMED = 3


@dataclass(frozen=True)
class RunOptions:
    """How a training runs; none of it changes what is learned, but for the budget.

    out:         file of the finished avatar
    work:        folder of everything else
    stamp:       the options that decide what is learned, as JSON can hold them; they must be the same at a resume
    budget:      how long to train
    start:       whether to begin, to resume, or to forget what the folder holds
    overwrite:   replace `out` even if this training did not write it
    log_steps:   steps that one line of the log averages
    checkpoint:  when to write one
    preview:     when to write one
    clock:       seconds by which all of this is timed
    """

    out: Path
    work: Path
    stamp: Stamp
    budget: Budget
    start: Start = Start.NEW
    overwrite: bool = False
    log_steps: int = LOG_EVERY_STEPS
    checkpoint: Every = CHECKPOINTS
    preview: Every = PREVIEWS
    clock: Callable[[], float] = time.monotonic


@dataclass(frozen=True)
class Outcome:
    """How a training ended.

    finished: else somebody stopped it, and it can be resumed
    state:   where it stands
    psnr:     of the fixed views, dB
    """

    finished: bool
    state: LoopState
    psnr: float


def train(build: Callable[[], Trainable], options: RunOptions, display: Display | None = None) -> Outcome:
    """Trains what `build` makes, and writes the avatar when it is finished.

    Everything that can be refused is refused before `build` is called. Raises InputError and RetryError for files and
    folders, JGHandError when the guard gives up, and whatever a step raises; the last checkpoint is then still there.
    """
    display = display or Silent()
    check_places(options)
    work = WorkFolder(options.work, options.stamp, options.budget)
    with work.opened(options.start):
        training = build()
        loop = Loop(training, options, work, Log(work.log), display)
        if options.start is Start.RESUME:
            work.remember_budget()
        with stop_requests() as stop:
            finished = loop.run(stop)
        if finished:
            _finish(training, options)
        return Outcome(finished, loop.state, loop.psnr)


def check_places(options: RunOptions) -> None:
    """InputError when the files and folders that `options` name are in use for something else."""
    check_folder(options.work, options.start)
    check_output(options.out, options.work, overwrite=options.overwrite)


def _finish(training: Trainable, options: RunOptions) -> None:
    try:
        # again: hours may have passed
        check_output(options.out, options.work, overwrite=options.overwrite)
        write_output(options.out, options.work, with_fist(training.avatar()))
    except InputError as error:
        remedy = f"The training is safe: --resume --work {options.work} with another --out writes its avatar."
        raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy=remedy) from error


class Loop:
    """One session of a training: from its newest checkpoint to the end of the budget, or to a stop."""

    def __init__(self, training: Trainable, options: RunOptions, work: WorkFolder, log: Log, display: Display) -> None:
        self._training, self._options, self._work = training, options, work
        self._log, self._display = log, display
        self._figures: Mapping[str, float] = {}
        self._ends_s: deque[float] = deque(maxlen=LOG_EVERY_STEPS + 1)
        self.psnr, self.state = math.nan, self._restored()

    def _restored(self) -> LoopState:
        """Where the newest checkpoint stands, put into the training; the beginning without one."""
        found, damaged = self._work.checkpoints.newest()
        for error in damaged:
            self._display.note(f"Passed over: {error}")
        if found is not None:
            check_fits(found.tensors, self._training, str(self._options.work))
            self._display.note(f"Resuming at step {found.state.step}.")
            return found.restore(self._training)
        if self._options.start is Start.RESUME:
            self._display.note("There is no checkpoint yet: beginning at step 0.")
        return LoopState()

    def run(self, stop: Event) -> bool:
        """True when the budget is spent, False after a stop; in both cases the newest checkpoint is where it ended."""
        now_s = self._options.clock()
        self._spent_before_s, self._began_s = self.state.seconds, now_s
        self._checkpoint_timer = Timer(self._options.checkpoint, self.state.step, now_s)
        self._preview_timer = Timer(self._options.preview, self.state.step, now_s)
        self._log.cut_after(self.state.step)
        self._plan()
        self._good = self._snapshot()
        if self.state.step == 0:
            self._checkpoint()
        while not (finished := self._options.budget.is_spent(self.state)) and not stop.is_set():
            self._one_step()
        if finished:
            self._write_line()
            self._write_preview_picture()
        self._checkpoint()
        return finished

    # ---- a step ------------------------------------------------------------------------------------------------------

    def _one_step(self) -> None:
        number = self.state.step
        if number not in self.state.skipped:
            self._figures = self._training.step(number)
            if findings := find_non_finite(self._figures, self._training):
                self._recover(number, findings)
                return
            add_figures(self.state, self._figures)
        self.state.step += 1
        self._take_time()
        self._show()
        self._now_and_then()

    def _recover(self, number: int, findings: list[str]) -> None:
        best = self.state.best_step, self.state.best_psnr
        self._good = recovered(self._good, number, findings, self._training)
        self.state = copy.deepcopy(self._good.state)
        self.state.best_step, self.state.best_psnr = best
        self._take_time()
        self._log.cut_after(self.state.step)
        what = "; ".join(findings[:FINDINGS_NAMED])
        self._log.write(self.state.step, {}, not_finite=what, skipped=number)
        self._display.note(
            f"Step {number} gave values that are not finite ({what}): back to step {self.state.step}, "
            f"step {number} is left out."
        )

    # ---- between steps -----------------------------------------------------------------------------------------------

    def _now_and_then(self) -> None:
        step, now_s = self.state.step, self._options.clock()
        if step % GUARD_KEEP_STEPS == 0 or step in GUARD_KEEPS_AT_FIRST:
            self._plan()
            self._good = self._snapshot()
        if step % self._options.log_steps == 0:
            self._write_line()
        if self._checkpoint_timer.is_due(step, now_s):
            self._checkpoint()
        if self._preview_timer.is_due(step, now_s):
            picture = self._write_preview_picture()
            save_avatar(self._work.preview, self._training.avatar())
            self._display.note(f"Preview: {picture} and {self._work.preview}")

    def _plan(self) -> None:
        self.state.planned_steps = self._options.budget.planned_steps(self.state)
        self._training.plan(self.state.planned_steps)

    def _snapshot(self) -> Snapshot:
        return Snapshot.of(self._training, self.state)

    def _write_line(self) -> None:
        if means := take_means(self.state):
            self._log.write(self.state.step, means, seconds=round(self.state.seconds, 3), steps_per_s=self._speed())

    def _checkpoint(self) -> None:
        self.psnr = self._training.fixed_psnr()
        if math.isfinite(self.psnr) and self.psnr > (self.state.best_psnr or -math.inf):
            self.state.best_step, self.state.best_psnr = self.state.step, self.psnr
        self._log.write(self.state.step, {"psnr": self.psnr})
        self._work.checkpoints.save(self._snapshot())

    def _write_preview_picture(self) -> Path:
        path = self._work.pictures / f"step_{self.state.step:08d}.png"
        write_png(path, to_bytes(self._training.preview()))
        return path

    def _show(self) -> None:
        state, speed = self.state, self._speed()
        gaussians = self._figures.get(GAUSSIANS)
        self._display.update(
            Status(
                step=state.step,
                steps=state.planned_steps,
                loss=self._figures.get(LOSS),
                psnr=self.psnr if math.isfinite(self.psnr) else None,
                gaussians=None if gaussians is None else round(gaussians),
                steps_per_s=speed,
                seconds_left=self._options.budget.seconds_left(state, speed),
            )
        )

    def _take_time(self) -> None:
        now_s = self._options.clock()
        self._ends_s.append(now_s)
        self.state.seconds = self._spent_before_s + now_s - self._began_s

    def _speed(self) -> float | None:
        """Steps per second lately; None before there were two."""
        if len(self._ends_s) < 2 or self._ends_s[-1] <= self._ends_s[0]:
            return None
        return (len(self._ends_s) - 1) / (self._ends_s[-1] - self._ends_s[0])


# ---- the log --------------------------------------------------------------------------------------------------------


def add_figures(state: LoopState, figures: Mapping[str, float]) -> None:
    """Adds a step's figures to those that the next line will average."""
    for name, value in figures.items():
        state.sums[name] = state.sums.get(name, 0.0) + value
    state.summed += 1


def take_means(state: LoopState) -> dict[str, float]:
    """The means since the last time, which are forgotten; empty when there was no step."""
    means = {name: total / state.summed for name, total in state.sums.items()}
    state.sums, state.summed = {}, 0
    return means


class Log:
    """The file `path`: one JSON object per line (JSONL). `step` is the number of steps done, the figures are means over
    those since the line before."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def write(self, step: int, figures: Mapping[str, float], **more: Any) -> None:
        """Appends one line. InputError or RetryError when it cannot be written."""
        line = json.dumps({"step": step, **{name: _number(value) for name, value in figures.items()}, **more})
        try:
            with open(self._path, "a", encoding="utf-8") as stream:
                stream.write(line + "\n")
        except OSError as error:
            raise file_error(self._path, error) from error

    def cut_after(self, step: int) -> None:
        """Removes the lines of steps after `step`, and one that a kill left half-written."""
        if not self._path.exists():
            return
        lines = self._path.read_text(encoding="utf-8", errors="replace").splitlines()
        kept = [line for line in lines if (number := _step_of(line)) is not None and number <= step]
        if kept != lines:
            write_file(self._path, "".join(line + "\n" for line in kept))


def _step_of(line: str) -> int | None:
    try:
        step = json.loads(line)["step"]
    except (ValueError, TypeError, KeyError):
        return None
    return step if isinstance(step, int) else None


def _number(value: float) -> float | None:
    """JSON has neither NaN nor infinity: the PSNR of a perfect picture is infinite."""
    return value if math.isfinite(value) else None
