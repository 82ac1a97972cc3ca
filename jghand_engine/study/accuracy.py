"""`jghand study accuracy`: what accuracy costs in time, as rows, tables and a headline.

What is compared stands in accuracy_variants, how it is measured in accuracy_measures, the exact pictures that errors
are taken from in accuracy_reference, how time grows in accuracy_growth, the plot in accuracy_plot.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jghand_engine.learn.tables import NONE, Table, number
from jghand_engine.render.budget import LOOKS_SAME_DB
from jghand_engine.render.settings import PRESETS
from jghand_engine.study.accuracy_growth import Growth
from jghand_engine.study.accuracy_reference import Error
from jghand_engine.study.accuracy_variants import AXES, TOGETHER

# part by which medians of one run differ without a reason: a preset is on the front unless something is faster by more
FRONT_NOISE = 0.05
# rows of the table of a training, at most
LEARNING_ROWS = 12


@dataclass(frozen=True)
class Row:
    """One variant."""

    # one of AXES
    axis: str
    name: str
    # whole frame, and medians of its stages by name
    median_ms: float
    p95_ms: float
    stages_ms: Mapping[str, float]
    # against the exact picture
    error: Error
    # mean metrics against the pictures of a capture
    truth: Mapping[str, float] = field(default_factory=dict)
    # see Measurement
    samples: int = 0
    dropped: int = 0
    disturbed: bool = False
    # in words
    looks: str = ""
    # whether nothing that can be chosen is both faster and more accurate
    on_front: bool = False
    # (H, W, 3) uint8: the finger tips
    crop: np.ndarray | None = None

    @property
    def preset(self) -> bool:
        return self.axis == TOGETHER and self.name in PRESETS


@dataclass(frozen=True)
class Accuracy:
    """Everything that was measured."""

    avatar: str
    gaussians: int
    size_px: tuple[int, int]
    machine: Mapping[str, Any]
    rows: tuple[Row, ...]
    growth: tuple[Growth, ...]
    # poses that were drawn in double precision
    poses: int
    # the pictures of a capture, in words; empty without
    truth: str
    # minutes, and PSNR of held-out views, of the training of the avatar
    learning: tuple[tuple[float, float], ...] = ()

    @property
    def choices(self) -> list[Row]:
        """What can be chosen, from the fastest."""
        return sorted((row for row in self.rows if row.axis == TOGETHER), key=lambda row: row.median_ms)

    @property
    def front(self) -> list[Row]:
        """From the fastest to the most accurate."""
        return [row for row in self.choices if row.on_front]

    @property
    def disturbed(self) -> bool:
        """Whether the machine had other work during most of the measurement of any setting."""
        return any(row.disturbed for row in self.rows)

    @property
    def headline(self) -> str:
        """The quickest setting that looks the same, and what less time takes away."""
        same = [row for row in self.front if row.error.psnr_db >= LOOKS_SAME_DB]
        less = [row for row in self.front if not same or row.median_ms < same[0].median_ms]
        # of several that look alike the most exact one
        told = {row.looks: f"{row.median_ms:.0f} ms: {row.looks}" for row in [*less, *same[:1]]}
        return "; ".join([*told.values()][::-1][:3]) or "nothing can be chosen"

    @property
    def how_timed(self) -> str:
        """Hardware, threads, sizes, in words."""
        facts = self.machine
        samples = min((row.samples for row in self.rows), default=0)
        return (
            f"{self.size_px[0]} x {self.size_px[1]} pixels, {self.gaussians:,} Gaussians; median of at least {samples} "
            f"frames, all settings in turn; {facts['processor']}, {facts['threads']} of {facts['cores']} threads, "
            f"kernels {facts['backend']}"
        )

    def tables(self) -> list[Table]:
        """What can be chosen, every axis alone, growth, and the training where there is one."""
        rows = [row for axis in AXES[1:] for row in self.rows if row.axis == axis]
        found = [_table("What can be chosen", self.choices, self._notes())]
        if rows:
            found.append(_table("One thing changed alone, all else as preset final", rows, ()))
        if self.growth:
            found.append(self._growth_table())
        if self.learning:
            found.append(self._learning_table())
        return found

    def _notes(self) -> tuple[str, ...]:
        beaten = [
            f"Preset {row.name} is not on the front: {better.name} is as accurate and takes {better.median_ms:.1f} ms."
            for row in self.rows
            if row.preset and not row.on_front and (better := faster_than(row, self.rows)) is not None
        ]
        busy = "✗: the machine had other work meanwhile, the time is too long. Measure again when it is quiet."
        return (
            "●: on the front, nothing is both faster and more accurate. A preset keeps its place when what beats it is "
            f"faster by less than {100 * FRONT_NOISE:.0f} %, which is noise.",
            f"dB: whole picture over black, against the same hand drawn in float64 with nothing left out, {self.poses} "
            "poses together; worst: of any pixel and channel.",
            *((f"PSNR: against {self.truth}.",) if self.truth else ()),
            f"ms: whole frame from joints to picture, nothing reused, no file read or written, {self.how_timed}.",
            *beaten,
            *((busy,) if self.disturbed else ()),
        )

    def _growth_table(self) -> Table:
        cells = tuple(
            (point.panel, f"{point.x:,}", _ms(point.median_ms, point.disturbed), _ms(point.p95_ms, point.disturbed))
            for point in self.growth
        )
        notes = ("Preset viewport, nothing reused. Poses in a batch: the bones of all of them in one call of torch.",)
        return Table("How time grows", ("With", "How many", "ms", "95 %"), cells, notes)

    def _learning_table(self) -> Table:
        """At most LEARNING_ROWS, evenly spread, the last one among them."""
        step = -(-len(self.learning) // LEARNING_ROWS)
        chosen = self.learning[::-1][::step][::-1]
        cells = tuple((f"{minutes:.0f}", number(psnr_db, 2)) for minutes, psnr_db in chosen)
        notes = ("PSNR of views that the training did not learn from, cut to the hand.",)
        return Table("Training: accuracy against minutes", ("Minutes", "PSNR"), cells, notes)


def _table(title: str, rows: Sequence[Row], notes: tuple[str, ...]) -> Table:
    cells = tuple(
        (
            row.name if row.axis == TOGETHER else f"{row.axis}: {row.name}",
            _ms(row.median_ms, row.disturbed),
            _ms(row.p95_ms, row.disturbed),
            number(row.error.psnr_db, 1),
            number(255 * row.error.worst, 1),
            number(row.truth.get("psnr_full"), 2),
            (f"● {row.looks}" if row.on_front else row.looks) or NONE,
        )
        for row in rows
    )
    return Table(title, ("Setting", "ms", "95 %", "dB", "Worst, 8-bit steps", "PSNR", "Looks"), cells, notes)


def _ms(value: float, disturbed: bool) -> str:
    return f"{value:.1f}{' ✗' if disturbed else ''}"


def faster_than(row: Row, rows: Sequence[Row]) -> Row | None:
    """The fastest that can be chosen, is as accurate as `row` and faster by more than times vary; None for none."""
    limit_ms = row.median_ms * (1 - FRONT_NOISE)
    better = [
        one
        for one in rows
        if one.axis == TOGETHER and one.error.psnr_db >= row.error.psnr_db and one.median_ms < limit_ms
    ]
    return min(better, key=lambda one: one.median_ms, default=None)
