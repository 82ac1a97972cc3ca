"""Where the milliseconds went: the reports of many frames as one table and as plain data."""

from __future__ import annotations

from typing import Any

import numpy as np

from jghand_engine.cli.console import say_table

TOTAL = "whole frame"


class Timings:
    """Collects milliseconds by stage. The first frames warm up buffers and are left out of the figures when there are
    enough others."""

    WARM_UP = 2
    ENOUGH = 10

    def __init__(self) -> None:
        self._ran: dict[str, list[float]] = {}
        self._skipped: dict[str, int] = {}
        self._reasons: dict[str, str] = {}
        self.frames = 0

    def add(self, report: dict[str, Any]) -> None:
        """Adds one `FrameReport.as_dict()`."""
        self.frames += 1
        for stage in report["stages"]:
            name = stage["name"]
            self._ran.setdefault(name, [])
            self._skipped.setdefault(name, 0)
            if stage["ran"]:
                self._ran[name].append(stage["milliseconds"])
            else:
                self._skipped[name] += 1
                self._reasons[name] = stage["reason"]
        self._ran.setdefault(TOTAL, []).append(report["total_ms"])

    def add_ms(self, name: str, milliseconds: float) -> None:
        """Adds one measurement that is no part of the frame, as writing a file."""
        self._ran.setdefault(name, []).append(milliseconds)

    def figures(self) -> dict[str, dict[str, Any]]:
        """By stage: median_ms, p95_ms, frames it ran on, frames it was skipped on (and the last reason why)."""
        result: dict[str, dict[str, Any]] = {}
        for name, values in self._ran.items():
            entry: dict[str, Any] = {"ran": len(values), "skipped": self._skipped.get(name, 0)}
            if values:
                measured = values[self.WARM_UP :] if len(values) >= self.ENOUGH else values
                entry |= {
                    "median_ms": float(np.median(measured)),
                    "p95_ms": float(np.percentile(measured, 95)),
                }
            if name in self._reasons:
                entry["reason"] = self._reasons[name]
            result[name] = entry
        return result

    def show(self, title: str) -> None:
        """Prints the table: the stages in their order, the whole frame after them, what is no part of it last."""
        say_table(title, ("stage", "median ms", "p95 ms", "ran", "skipped"), self._rows())

    def _rows(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = []
        for name, entry in self.figures().items():
            times = [f"{entry[key]:.2f}" if key in entry else "-" for key in ("median_ms", "p95_ms")]
            rows.append((name, *times, str(entry["ran"]), str(entry["skipped"] or "")))
        return rows
