"""The log of a training: one JSON object per line (JSONL).

A line stands for the steps since the line before it: `step` is the number of steps done, the figures are means over
them. A training that goes back, or goes on from a checkpoint, first cuts what lies after the step it starts from.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from jghand_engine.files import file_error, write_file
from jghand_engine.learn.checkpoint import LoopState


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
    """The file `path`, which grows by a line at a time."""

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
