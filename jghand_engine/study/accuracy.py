"""`jghand study accuracy`: what accuracy costs in time, measured together, as tables and as plain data.

variants     accuracy_variants     what is compared
measuring    accuracy_measures
errors       accuracy_reference    against the engine's own picture in double precision
truth        training.evaluate     against pictures of a capture
times        timing                all in turn, in one run
growth       accuracy_growth       with Gaussians, pixels, hands, poses
the page     accuracy_plot, accuracy_page
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jghand_engine import limits
from jghand_engine.learn.tables import NONE, Table, number
from jghand_engine.render.settings import PRESETS
from jghand_engine.study.accuracy_growth import Growth
from jghand_engine.study.accuracy_reference import Error
from jghand_engine.study.accuracy_variants import AXES, BLEND, HALF_SHADOW, SEPARABLE, SHADOW, TOGETHER

Picture = np.ndarray


@dataclass(frozen=True)
class Row:
    """One variant. median_ms, p95_ms, stages_ms (medians by name), samples, dropped, disturbed: see Measurement; no
    times (None) of what has no kernel · error: against the exact picture · truth: metrics against the pictures of a
    capture · looks: in words · on_front: of all that can be chosen · crop: (H, W, 3) uint8, where finger tips are"""

    axis: str
    name: str
    median_ms: float | None
    p95_ms: float | None
    stages_ms: Mapping[str, float]
    error: Error
    truth: Mapping[str, float] = field(default_factory=dict)
    samples: int = 0
    dropped: int = 0
    disturbed: bool = False
    looks: str = ""
    on_front: bool = False
    crop: Picture | None = None

    @property
    def preset(self) -> bool:
        return self.axis == TOGETHER and self.name in PRESETS

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        kept = {name: value for name, value in vars(self).items() if name not in ("crop", "error")}
        return kept | {"psnr_db": self.error.psnr_db, "worst": self.error.worst}


@dataclass(frozen=True)
class Accuracy:
    """Everything that was measured. learning: minutes and PSNR of held-out views, of a training on `learned_from`"""

    avatar: str
    gaussians: int
    size_px: tuple[int, int]
    machine: Mapping[str, Any]
    rows: tuple[Row, ...]
    growth: tuple[Growth, ...]
    poses: int
    truth: str
    learning: tuple[tuple[float, float], ...] = ()
    learned_from: str = ""

    @property
    def front(self) -> list[Row]:
        """From the fastest to the most accurate."""
        return sorted((row for row in self.rows if row.on_front), key=lambda row: row.median_ms or 0)

    @property
    def disturbed(self) -> bool:
        """Whether the machine had other work during most of the measurement of any setting."""
        return any(row.disturbed for row in self.rows)

    @property
    def headline(self) -> str:
        """What a reader wants to know: the quickest that looks the same, and what less time takes away."""
        same = [row for row in self.front if row.error.psnr_db >= limits.LOOKS_SAME_DB]
        less = [row for row in self.front if not same or (row.median_ms or 0) < (same[0].median_ms or 0)]
        # of several that look alike the most exact one
        told = {row.looks: f"{row.median_ms:.0f} ms: {row.looks}" for row in [*less, *same[:1]]}
        return "; ".join([*told.values()][::-1][:3]) or "nothing can be chosen"

    @property
    def warning(self) -> str:
        """A sentence when the times are not to be trusted, else empty."""
        if not self.disturbed:
            return ""
        return "The machine had other work meanwhile: the times marked ✗ are too long. Measure again when it is quiet."

    @property
    def beaten(self) -> list[str]:
        """Sentences: presets that are no points of the front, and what is better."""
        return [
            f"Preset {row.name} is not on the front: {better.name} is as accurate and takes {better.median_ms:.1f} ms."
            for row in self.rows
            if row.preset and not row.on_front and (better := faster_than(row, self.rows)) is not None
        ]

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON."""
        return {
            "avatar": self.avatar, "gaussians": self.gaussians, "size_px": list(self.size_px),
            "machine": dict(self.machine), "disturbed": self.disturbed, "headline": self.headline,
            "reference": f"{self.poses} poses in float64", "truth": self.truth,
            "rows": [row.as_dict() for row in self.rows], "growth": [vars(point) for point in self.growth],
            "learning": [{"minutes": minutes, "psnr_db": psnr_db} for minutes, psnr_db in self.learning],
            "learnt_from": self.learned_from,
        }  # fmt: skip

    def tables(self) -> list[Table]:
        """Every axis in a table of its own, then growth."""
        return [
            *(self._table(axis) for axis in AXES if any(row.axis == axis for row in self.rows)),
            self._growth_table(),
            *([self._learning_table()] if self.learning else []),
        ]

    def short_tables(self) -> list[Table]:
        """What can be chosen, for a terminal."""
        rows = sorted((row for row in self.rows if row.axis == TOGETHER), key=lambda row: row.median_ms or 0)
        cells = tuple(
            (row.name, _ms(row.median_ms, row.disturbed), _ms(row.p95_ms, row.disturbed),
             number(row.error.psnr_db, 1), number(row.truth.get("psnr_full"), 2), _marked(row))
            for row in rows
        )  # fmt: skip
        columns = ("Setting", "ms", "95 %", "dB", "PSNR", "Looks")
        notes = ("All columns, and every axis alone, are in ACCURACY.md and accuracy.html.",)
        return [Table(_TITLES[TOGETHER], columns, cells, self._notes(TOGETHER) + notes)]

    def _table(self, axis: str) -> Table:
        rows = [row for row in self.rows if row.axis == axis]
        if axis == TOGETHER:
            rows.sort(key=lambda row: row.median_ms or 0)
        metrics = list(dict.fromkeys(name for row in self.rows for name in row.truth))
        columns = ("Setting", "ms", "95 %", "dB", "Worst, 8-bit steps", *(_METRICS.get(m, m) for m in metrics), "Looks")
        cells = tuple(
            (
                f"**{row.name}**" if row.preset else row.name,
                _ms(row.median_ms, row.disturbed), _ms(row.p95_ms, row.disturbed), number(row.error.psnr_db, 1),
                number(255 * row.error.worst, 1), *(_metric(row.truth.get(name), name) for name in metrics),
                _marked(row),
            )
            for row in rows
        )  # fmt: skip
        return Table(_TITLES.get(axis, f"{axis[0].upper()}{axis[1:]}, all else as preset final"), columns, cells,
                     self._notes(axis))  # fmt: skip

    def _notes(self, axis: str) -> tuple[str, ...]:
        if axis != TOGETHER:
            return _NOTES.get(axis, ())
        truth = (f"PSNR and so on: against {self.truth}.",) if self.truth else ()
        return (
            "●: on the front, nothing is both faster and more accurate. A preset keeps its place when what beats it is "
            f"faster by less than {100 * limits.FRONT_NOISE:.0f} %, which is noise.",
            f"dB: whole picture over black, against the same hand drawn in float64 with nothing left out, {self.poses} "
            "poses together; worst: of any pixel and channel.",
            *truth,
            f"ms: whole frame from joints to picture, nothing reused, no file read or written, {self.how_timed}.",
            *self.beaten,
            *([self.warning] if self.warning else []),
        )

    @property
    def how_timed(self) -> str:
        """Hardware, threads, sizes, in words."""
        facts = self.machine
        samples = min((row.samples for row in self.rows if row.median_ms is not None), default=0)
        return (
            f"{self.size_px[0]} x {self.size_px[1]} pixels, {self.gaussians:,} Gaussians; median of at least {samples} "
            f"frames, all settings in turn; {facts['processor']}, {facts['threads']} of {facts['cores']} threads, "
            f"kernels {facts['backend']}"
        )

    def _growth_table(self) -> Table:
        cells = tuple(
            (point.panel, f"{point.x:,}", _ms(point.median_ms, point.disturbed), _ms(point.p95_ms, point.disturbed))
            for point in self.growth
        )
        notes = ["Preset viewport, nothing reused. Poses in a batch: the bones of all of them in one call of torch."]
        if any(point.disturbed for point in self.growth):
            notes.append("✗: the threads of most of these calls had to wait for the processor; the time is too long.")
        return Table("How time grows", ("With", "How many", "ms", "95 %"), cells, tuple(notes))

    def _learning_table(self) -> Table:
        """At most so many rows, evenly spread, the last one among them."""
        step = -(-len(self.learning) // _LEARNING_ROWS)
        chosen = self.learning[::-1][::step][::-1]
        cells = tuple((f"{minutes:.0f}", number(psnr_db, 2)) for minutes, psnr_db in chosen)
        origin = f" on {self.learned_from}" if self.learned_from else ""
        notes = (f"A training{origin}: PSNR of views that it did not learn from, cut to the hand.",)
        return Table("Training: accuracy against minutes", ("Minutes", "PSNR"), cells, notes)


_LEARNING_ROWS = 12
_METRICS = {"psnr_full": "PSNR", "psnr_box": "PSNR, box", "ssim_full": "SSIM", "ssim_box": "SSIM, box",
            "flip_box": "FLIP, box", "st_lpips_box": "ST-LPIPS, box", "lpips_box": "LPIPS, box"}  # fmt: skip
_TITLES = {TOGETHER: "What can be chosen"}
_NOTES = {
    BLEND: (
        f"{SEPARABLE}: its accuracy only. On a prototype its kernel was slower than ours (docs/RENDERING.md 6.2); it "
        "is not built.",
    ),
    SHADOW: (
        f"{HALF_SHADOW}: its accuracy only. It is not built: what it could save is part of the difference between "
        "the shadow of 64 samples and none.",
    ),
}


def _ms(value: float | None, disturbed: bool) -> str:
    return NONE if value is None else f"{value:.1f}{' ✗' if disturbed else ''}"


def _marked(row: Row) -> str:
    return (f"● {row.looks}" if row.on_front else row.looks) or NONE


def _metric(value: float | None, name: str) -> str:
    return number(value, 2 if name.startswith("psnr") else 3)


def faster_than(row: Row, rows: Sequence[Row]) -> Row | None:
    """The fastest that can be chosen, is as accurate as `row` and faster by more than times vary; None for none."""
    limit_ms = (row.median_ms or 0) * (1 - limits.FRONT_NOISE)
    better = [
        one
        for one in rows
        if one.axis == TOGETHER and one.error.psnr_db >= row.error.psnr_db and (one.median_ms or 0) < limit_ms
    ]
    return min(better, key=lambda one: one.median_ms or 0, default=None)
