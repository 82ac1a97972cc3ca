"""What a training shows while it runs: a live line in a terminal, plain lines now and then where there is none."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

# seconds between two lines of progress where no terminal shows a bar
PROGRESS_LINE_S = 15.0


@dataclass(frozen=True)
class Status:
    """Where a training stands; None is not known yet.

    step:         steps done
    steps:        steps planned
    loss:         of the last step
    psnr:         mean of the fixed views, cut to the hand, dB
    gaussians:    that the step drew
    steps_per_s:  lately
    seconds_left: to the end
    """

    step: int
    steps: int
    loss: float | None = None
    psnr: float | None = None
    gaussians: int | None = None
    steps_per_s: float | None = None
    seconds_left: float | None = None

    def sentence(self) -> str:
        parts = [f"step {self.step} of {self.steps}"]
        if self.loss is not None:
            parts.append(f"loss {self.loss:.4f}")
        if self.psnr is not None:
            parts.append(f"fixed views {self.psnr:.2f} dB")
        if self.gaussians is not None:
            parts.append(f"{self.gaussians} Gaussians")
        if self.steps_per_s is not None:
            parts.append(f"{self.steps_per_s:.2f} steps/s")
        if self.seconds_left is not None:
            parts.append(f"{duration(self.seconds_left)} left")
        return " · ".join(parts)


def duration(seconds: float) -> str:
    """`7 s`, `12 min`, `1 h 05 min`."""
    if seconds < 59.5:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02d} min"


class Display(Protocol):
    """Where a training says how it goes."""

    def update(self, status: Status) -> None: ...

    def note(self, sentence: str) -> None: ...


class Silent:
    """Says nothing, for tests and scripts."""

    def update(self, status: Status) -> None: ...

    def note(self, sentence: str) -> None: ...


@contextmanager
def display(console: Console) -> Iterator[Display]:
    """A live line at the bottom of a terminal, or plain lines every PROGRESS_LINE_S."""
    if not console.is_terminal:
        yield PlainLines(console)
        return
    columns = (TextColumn("Training"), BarColumn(bar_width=24), TextColumn("{task.description}"))
    with Progress(*columns, console=console) as bar:
        yield LiveLine(bar, bar.add_task("", total=1))


class LiveLine:
    """A bar with the status beside it; notes stay above it."""

    def __init__(self, bar: Progress, task: TaskID) -> None:
        self._bar, self._task = bar, task

    def update(self, status: Status) -> None:
        self._bar.update(self._task, description=status.sentence(), completed=status.step, total=status.steps)

    def note(self, sentence: str) -> None:
        self._bar.console.print(sentence, markup=False)


class PlainLines:
    """One line of status now and then, for logs and pipes."""

    def __init__(self, console: Console) -> None:
        self._console, self._last_s = console, -PROGRESS_LINE_S

    def update(self, status: Status) -> None:
        now_s = time.monotonic()
        if now_s - self._last_s >= PROGRESS_LINE_S or status.step >= status.steps:
            self._last_s = now_s
            self.note(status.sentence())

    def note(self, sentence: str) -> None:
        self._console.print(sentence, markup=False)
