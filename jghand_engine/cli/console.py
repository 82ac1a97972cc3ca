"""What the command line says: results and tables on standard output, progress and errors on standard error."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from jghand_engine.cli.progress_json import JsonLines, json_lines
from jghand_engine.json_files import write_json

if TYPE_CHECKING:
    from jghand_engine.learn.tables import Table as Figures


class _Console(Console):
    def on_broken_pipe(self) -> None:
        """Whoever reads, such as `head`, has seen enough: the command goes on, and what it says is dropped."""
        os.dup2(os.open(os.devnull, os.O_WRONLY), self.file.fileno())


def out() -> Console:
    """Standard output, looked up anew so that a test can capture it; sentences are not broken at a guessed width."""
    return _Console(highlight=False, soft_wrap=True, emoji=False)


def err() -> Console:
    return _Console(stderr=True, highlight=False, soft_wrap=True, emoji=False)


def say(text: str = "") -> None:
    """One line of the result, without reading rich's markup into it."""
    out().print(text, markup=False)


def say_error(text: str) -> None:
    err().print(text, style="bold red", markup=False)


def say_table(title: str, columns: tuple[str, ...], rows: list[tuple[str, ...]]) -> None:
    """A table whose first column is text and whose others are figures."""
    table = Table(show_edge=False, pad_edge=False)
    for index, column in enumerate(columns):
        # a name that is too long for a narrow screen goes on in the next line: cut, two of them may look the same
        table.add_column(column, justify="right" if index else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    out().print(f"\n{title}", style="bold", markup=False)
    # soft wrapping would tear a wide table apart
    _Console(highlight=False, emoji=False).print(table)


def say_whole_table(table: Figures) -> None:
    say_table(table.title, table.columns, list(table.rows))
    for note in table.notes:
        say(f"  {note}")


class Bar:
    """How far one task is: `bar` draws it, or `lines` tell it to the program that started this one."""

    def __init__(self, bar: Progress, text: str, total: int, lines: JsonLines | None = None) -> None:
        self._bar, self._lines, self._task = bar, lines, bar.add_task(text, total=total)
        self._tell()

    @property
    def unseen(self) -> bool:
        return self._bar.disable

    def advance(self) -> None:
        self._bar.advance(self._task)
        self._tell()

    def reach(self, done: float, total: float | None = None) -> None:
        """total: None leaves it as it was"""
        self._bar.update(self._task, completed=done, total=total)
        self._tell()

    def _tell(self) -> None:
        if self._lines is not None:
            (task,) = self._bar.tasks
            self._lines.progress(task.description, task.completed, task.total or 0, task.time_remaining)


@contextmanager
def progress(text: str, total: int) -> Iterator[Bar]:
    """It stands on standard error and vanishes where nobody looks."""
    lines, columns = json_lines(), (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    hidden = lines is not None or not err().is_terminal
    with Progress(*columns, TimeRemainingColumn(), console=err(), transient=False, disable=hidden) as bar:
        yield Bar(bar, text, total, lines)


@contextmanager
def stages() -> Iterator[Callable[[str, int, int], None]]:
    """Call it with the name of a stage, how much of it is done, and of how much: a bar for each, in turn."""
    with ExitStack() as shown:
        bars: dict[str, Bar] = {}

        def told(stage: str, done: int, total: int) -> None:
            if stage not in bars:
                shown.close()
                bars.clear()
                bars[stage] = shown.enter_context(progress(stage, total))
            bars[stage].reach(done, max(done, total))

        yield told


def write_figures(path: Path | None, content: dict[str, Any]) -> None:
    """What --json asks for; nothing where it was left out."""
    if path is not None:
        write_json(path, content)
