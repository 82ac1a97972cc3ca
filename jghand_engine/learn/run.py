"""The training loop: steps, and between them the log, checkpoints, previews, and what a stop or a fault asks for.

with a lock on the folder, a new or resumed course
    until the budget is spent or somebody stops it
        one step; the guard looks at it
        now and then: a copy for the guard, a line of the log, a checkpoint, a preview
the finished avatar
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from jghand_engine.errors import InputError
from jghand_engine.learn.checkpoint import Course, Snapshot, Stamp, check_fits
from jghand_engine.learn.guard import GUARD_KEEP_STEPS, Finding, Guard, find_non_finite
from jghand_engine.learn.log import Board, Log, add_figures, take_means
from jghand_engine.learn.progress import Display, Silent, Status
from jghand_engine.learn.schedule import Budget, Every, StopRequest, Timer, stop_requests
from jghand_engine.learn.trainable import GAUSSIANS, LOSS, Trainable
from jghand_engine.learn.work_folder import Output, Previews, Start, WorkFolder, check_folder

# seconds between two checkpoints: what kill -9 may lose. Writing one takes some 40 ms (RENDERING 13, promise 20)
CHECKPOINT_EVERY_S = 60.0
# seconds to the first preview, which is promised within a minute, and between two later ones
FIRST_PREVIEW_S = 15.0
PREVIEW_EVERY_S = 180.0
# steps that one line of the log averages
LOG_EVERY_STEPS = 20
# ... and at the beginning, where the plan of a time budget has to find the speed
GUARD_KEEPS_AT_FIRST = (2, 5, 10, 20)

CHECKPOINTS = Every(seconds=CHECKPOINT_EVERY_S)
# of the values that are not finite, so many are said; the dump has them all
FINDINGS_SAID = 3
PREVIEWS = Every(seconds=PREVIEW_EVERY_S, first_s=FIRST_PREVIEW_S)


@dataclass(frozen=True)
class RunOptions:
    """How a training runs; none of it changes what is learned, but for the budget.

    out: the file of the finished avatar · work: folder of everything else · stamp: the options that decide what is
    learned, as JSON can hold them; they must be the same when the training goes on
    """

    out: Path
    work: Path
    stamp: Stamp
    budget: Budget
    start: Start = Start.NEW
    overwrite: bool = False
    tensorboard: bool = False
    log_steps: int = LOG_EVERY_STEPS
    checkpoint: Every = CHECKPOINTS
    preview: Every = PREVIEWS


@dataclass(frozen=True)
class Outcome:
    """How a training ended. finished: else somebody stopped it, and it can go on · psnr: of the fixed views, dB."""

    finished: bool
    course: Course
    psnr: float


def train(build: Callable[[], Trainable], options: RunOptions, display: Display | None = None) -> Outcome:
    """Trains what `build` makes, and writes the avatar when it is finished.

    Everything that can be refused is refused before `build` is called. Raises InputError and RetryError for files and
    folders, JGHandError when the guard gives up, and whatever a step raises; the last checkpoint is then still there.
    """
    shown = display or Silent()
    output = check_places(options)
    work = WorkFolder(options.work, options.stamp)
    with work.opened(options.start), closing(_log(work, options)) as log:
        trainable = build()
        course = _begin(trainable, work, options, shown)
        loop = Loop(trainable, options, work, log, shown, course)
        with stop_requests() as stop:
            finished = loop.run(stop)
        if finished:
            _write_output(output, trainable, options)
        return Outcome(finished, loop.course, loop.psnr)


def check_places(options: RunOptions) -> Output:
    """InputError when the files and folders that `options` name are in use for something else."""
    check_folder(options.work, options.start)
    output = Output(options.out, options.work / "output.json", overwrite=options.overwrite)
    output.check()
    return output


def _log(work: WorkFolder, options: RunOptions) -> Log:
    return Log(work.log, Board(work.board) if options.tensorboard else None)


def _begin(trainable: Trainable, work: WorkFolder, options: RunOptions, display: Display) -> Course:
    """Puts `trainable` where the newest checkpoint is, if there is one."""
    found, damaged = work.checkpoints.newest()
    for sentence in damaged:
        display.note(f"Passed over: {sentence}")
    if found is None:
        if options.start is Start.RESUME:
            display.note("There is no checkpoint yet: beginning at step 0.")
        course = Course()
        course.planned_steps = options.budget.planned_steps(course)
        trainable.plan(course.planned_steps)
        return course
    check_fits(found.tensors, trainable, f"{options.work}")
    course = found.restore(trainable)
    display.note(f"Going on at step {course.step}.")
    return course


def _write_output(output: Output, trainable: Trainable, options: RunOptions) -> None:
    try:
        output.write(trainable.avatar())
    except InputError as error:
        remedy = f"The training is safe: --resume --work {options.work} with another --out writes its avatar."
        raise InputError(error.thing, wanted=error.wanted, came=error.came, remedy=remedy) from error


class Loop:
    """One session of a training: from `course` to the end of the budget, or to a stop."""

    def __init__(
        self, trainable: Trainable, options: RunOptions, work: WorkFolder, log: Log, display: Display, course: Course
    ) -> None:
        self.course, self.psnr = course, math.nan
        self._trainable, self._options, self._work = trainable, options, work
        self._log, self._display = log, display
        self._guard, self._previews = Guard(work.failures, options.stamp), Previews(work.path)
        self._figures: Mapping[str, float] = {}
        self._ends_s: deque[float] = deque(maxlen=LOG_EVERY_STEPS + 1)

    def run(self, stop: StopRequest) -> bool:
        """True when the budget is spent, False after a stop; in both cases the newest checkpoint is where it ended."""
        now_s = time.monotonic()
        self._spent_before_s, self._began_s = self.course.seconds, now_s
        self._checkpoint_timer = Timer(self._options.checkpoint, self.course.step, now_s)
        self._preview_timer = Timer(self._options.preview, self.course.step, now_s)
        self._log.cut_after(self.course.step)
        self._plan()
        self._guard.keep(Snapshot.of(self._trainable, self.course))
        if self.course.step == 0:
            self._checkpoint()
        while not (finished := self._options.budget.is_spent(self.course)) and not stop.requested:
            self._one_step()
        if finished:
            self._write_line()
            self._previews.write_picture(self.course.step, self._trainable)
        self._checkpoint()
        return finished

    # ---- a step ------------------------------------------------------------------------------------------------------

    def _one_step(self) -> None:
        number = self.course.step
        if number not in self.course.skipped:
            self._figures = self._trainable.step(number)
            if findings := find_non_finite(self._figures, self._trainable):
                self._recover(number, findings)
                return
            add_figures(self.course, self._figures)
        self.course.step += 1
        self._take_time()
        self._show()
        self._now_and_then()

    def _recover(self, number: int, findings: list[Finding]) -> None:
        good, dump = self._guard.recover(number, findings, self._trainable)
        best = self.course.best_step, self.course.best_psnr
        self.course = good.restore(self._trainable)
        self.course.best_step, self.course.best_psnr = best
        self._take_time()
        self._log.cut_after(self.course.step)
        what = "; ".join(str(finding) for finding in findings[:FINDINGS_SAID])
        self._log.write(self.course.step, {}, not_finite=what, skipped=number)
        self._display.note(
            f"Step {number} gave values that are not finite, first {what}: back to step {self.course.step}, "
            f"step {number} is left out. {dump} holds what repeats it."
        )

    # ---- between steps -----------------------------------------------------------------------------------------------

    def _now_and_then(self) -> None:
        step, now_s = self.course.step, time.monotonic()
        if step % GUARD_KEEP_STEPS == 0 or step in GUARD_KEEPS_AT_FIRST:
            self._plan()
            self._guard.keep(Snapshot.of(self._trainable, self.course))
        if step % self._options.log_steps == 0:
            self._write_line()
        if self._checkpoint_timer.is_due(step, now_s):
            self._checkpoint()
        if self._preview_timer.is_due(step, now_s):
            self._preview()

    def _plan(self) -> None:
        self.course.planned_steps = self._options.budget.planned_steps(self.course)
        self._trainable.plan(self.course.planned_steps)

    def _write_line(self) -> None:
        if means := take_means(self.course):
            self._log.write(self.course.step, means, seconds=round(self.course.seconds, 3), steps_per_s=self._speed())

    def _checkpoint(self) -> None:
        self.psnr = self._trainable.fixed_psnr()
        if math.isfinite(self.psnr) and self.psnr > (self.course.best_psnr or -math.inf):
            self.course.best_step, self.course.best_psnr = self.course.step, self.psnr
        self._log.write(self.course.step, {"psnr": self.psnr})
        self._work.checkpoints.save(Snapshot.of(self._trainable, self.course))

    def _preview(self) -> None:
        picture = self._previews.write_picture(self.course.step, self._trainable)
        avatar = self._previews.write_avatar(self._trainable)
        self._display.note(f"Preview: {picture} and {avatar}")

    def _show(self) -> None:
        course, speed = self.course, self._speed()
        gaussians = self._figures.get(GAUSSIANS)
        self._display.update(
            Status(
                step=course.step,
                steps=course.planned_steps,
                loss=self._figures.get(LOSS),
                psnr=self.psnr if math.isfinite(self.psnr) else None,
                gaussians=None if gaussians is None else round(gaussians),
                steps_per_s=speed,
                seconds_left=self._options.budget.seconds_left(course, speed),
            )
        )

    def _take_time(self) -> None:
        now_s = time.monotonic()
        self._ends_s.append(now_s)
        self.course.seconds = self._spent_before_s + now_s - self._began_s

    def _speed(self) -> float | None:
        """Steps per second lately; None before there were two."""
        if len(self._ends_s) < 2 or self._ends_s[-1] <= self._ends_s[0]:
            return None
        return (len(self._ends_s) - 1) / (self._ends_s[-1] - self._ends_s[0])
