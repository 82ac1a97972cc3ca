"""Where the milliseconds went, and which effects ran: the reports of many frames as tables and as plain data."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from jghand_engine.cli.console import say, say_table
from jghand_engine.native.rasterizer import DRAWN_HERE
from jghand_engine.render.report import EffectSums

if TYPE_CHECKING:
    from jghand_engine.render.report import FrameReport

TOTAL = "whole frame"


class Timings:
    """Collects milliseconds by stage. The first frames warm up buffers and are left out of the figures when there are
    enough others."""

    WARM_UP = 2
    ENOUGH = 10

    def __init__(self) -> None:
        self._stages: dict[str, list[float]] = {}
        self._totals: list[float] = []
        self._backends: dict[str, None] = {}
        self._fallbacks: list[str] = []
        self._others: dict[str, list[float]] = {}

    @property
    def frames(self) -> int:
        """How many reports were added."""
        return len(self._totals)

    @property
    def backend(self) -> str:
        """What drew: a native variant or torch, the slow reference; several with " and "."""
        return " and ".join(self._backends)

    def add(self, report: dict[str, Any]) -> None:
        """Adds one `FrameReport.as_dict()`."""
        for stage in report["stages"]:
            self._stages.setdefault(stage["name"], []).append(stage["milliseconds"])
        self._totals.append(report["total_ms"])
        if report.get("backend"):
            self._backends[report["backend"]] = None
        self._fallbacks += [note for note in report.get("notes", ()) if note.startswith(DRAWN_HERE)]

    def add_ms(self, name: str, milliseconds: float) -> None:
        """Adds one measurement that is no part of the frame, as writing a file."""
        self._others.setdefault(name, []).append(milliseconds)

    def figures(self) -> dict[str, dict[str, Any]]:
        """By stage: frames it ran on, median_ms and p95_ms.

        The stages in the order in which they were first seen, the whole frame after them, what is no part of it last.
        """
        result: dict[str, dict[str, Any]] = {}
        for name, values in {**self._stages, TOTAL: self._totals, **self._others}.items():
            entry: dict[str, Any] = {"ran": len(values)}
            if values:
                measured = values[self.WARM_UP :] if len(values) >= self.ENOUGH else values
                entry |= {"median_ms": float(np.median(measured)), "p95_ms": float(np.percentile(measured, 95))}
            result[name] = entry
        return result

    def show(self, title: str) -> None:
        """Prints `figures` as a table. What drew is added to the title: the slow fallback must be seen."""
        drawn = f", drawn by backend {self.backend}" if self.backend else ""
        say_table(title + drawn, ("stage", "median ms", "p95 ms", "ran"), self._rows())
        if self._fallbacks:
            say(f"{len(self._fallbacks)} of {self.frames} {self._fallbacks[0]}")

    def _rows(self) -> list[tuple[str, ...]]:
        rows: list[tuple[str, ...]] = []
        for name, entry in self.figures().items():
            times = [f"{entry[key]:.2f}" if key in entry else "-" for key in ("median_ms", "p95_ms")]
            rows.append((name, *times, str(entry["ran"])))
        return rows


class Receipts:
    """Collects the receipts of frames."""

    def __init__(self) -> None:
        self._first: list[str] = []
        self._sums = EffectSums()

    def add(self, report: FrameReport) -> None:
        """Adds one frame's."""
        self._first = self._first or report.lines()
        self._sums.add(report)

    def figures(self) -> dict[str, dict[str, Any]]:
        """See EffectSums."""
        return self._sums.figures()

    def show(self) -> None:
        """Prints the first frame's receipt and the table of all."""
        say("The first frame:")
        for line in self._first:
            say(f"  {line}")
        rows = [
            (name, str(one["ran"]), str(one["skipped"]), f"{one['saved_ms']:.1f}", one["reason"])
            for name, one in self.figures().items()
        ]
        say_table("All frames", ("effect", "ran", "skipped", "saved, about ms", "skipped last because"), rows)
