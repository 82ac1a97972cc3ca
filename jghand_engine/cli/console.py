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

from jghand_engine.cli.progress_json import JsonProgress, json_lines
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
    """A table with its notes below it."""
    say_table(table.title, table.columns, list(table.rows))
    for note in table.notes:
        say(f"  {note}")


@contextmanager
def progress(text: str, total: int) -> Iterator[Progress]:
    """A bar with one task; call `advance(task_id=0)`. It stands on standard error and vanishes where nobody looks, or
    is told in lines to the program that started this one."""
    lines = json_lines()
    if lines is not None:
        told = JsonProgress(lines)
        told.add_task(text, total=total)
        yield told
        return
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=err(), transient=False, disable=not err().is_terminal) as bar:
        bar.add_task(text, total=total)
        yield bar


@contextmanager
def stages() -> Iterator[Callable[[str, int, int], None]]:
    """Call it with the name of a stage, how much of it is done, and of how much: a bar for each, in turn."""
    with ExitStack() as shown:
        bars: dict[str, Progress] = {}

        def told(stage: str, done: int, total: int) -> None:
            if stage not in bars:
                shown.close()
                bars.clear()
                bars[stage] = shown.enter_context(progress(stage, total))
            bars[stage].update(bars[stage].task_ids[0], completed=done, total=max(done, total))

        yield told


def write_figures(path: Path | None, content: dict[str, Any]) -> None:
    """What --json asks for; nothing where it was left out."""
    if path is not None:
        write_json(path, content)
