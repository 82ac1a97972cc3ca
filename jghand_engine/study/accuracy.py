"""`jghand study accuracy`: what accuracy costs in time, as rows, tables and a headline.

What is compared stands in accuracy_variants, how it is measured in accuracy_measures, the exact pictures that errors
are taken from in accuracy_reference, how time grows in accuracy_growth, the plot in accuracy_plot.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from jghand_engine.avatar.tiers import LOST_MAX_DB
from jghand_engine.learn.tables import NONE, Table, number
from jghand_engine.native import contract
from jghand_engine.render.effect_plan import Effect
from jghand_engine.render.settings import PRESETS, RenderSettings, ShadowMode
from jghand_engine.study.accuracy_growth import Growth
from jghand_engine.study.accuracy_reference import Error
from jghand_engine.study.accuracy_variants import AXES, LIGHT, TOGETHER

# part by which medians of one run differ without a reason: a preset is on the front unless something is faster by more
FRONT_NOISE = 0.05
# standard errors by which a mean is taken to be certain
CERTAIN = 2.0
# accuracy of a whole image over black from which on an artist sees no difference, has to look for it, sees it at once
LOOKS_SAME_DB = 45.0
LOOKS_ALIKE_DB = 38.0
LOOKS_CLOSE_DB = 30.0
APPROXIMATE = "approximate creases"
LIGHT_NOTES = (
    "ms, dB, worst: preset final in a light of a world and three lamps; against preset reference in it, as displayed.",
    "PSNR, gain: of a capture in known light alone, in the light of each of its pictures.",
)

Named = TypeVar("Named")


@dataclass(frozen=True)
class TruthScore:
    """How near a setting is to pictures of a capture: PSNR of whole pictures over black, dB."""

    psnr_db: float
    # standard error of that mean over pictures
    error_db: float
    # mean over pictures of what it has more than preset `reference`, and the standard error of that
    gain_db: float
    gain_error_db: float

    @classmethod
    def of(cls, psnr_db: np.ndarray, exact_db: np.ndarray) -> TruthScore:
        """From the PSNR of each picture, its own and that of preset `reference`."""
        return cls(*_mean_and_error(psnr_db), *_mean_and_error(psnr_db - exact_db))

    @property
    def as_near(self) -> bool:
        """Whether it certainly loses no more than a tier may that is taken unasked."""
        return self.gain_db - CERTAIN * self.gain_error_db >= -LOST_MAX_DB


def _mean_and_error(values: np.ndarray) -> tuple[float, float]:
    return float(values.mean()), float(values.std() / np.sqrt(max(len(values) - 1, 1)))


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
    # against the pictures of a capture, or None without
    truth: TruthScore | None = None
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
    # the command that must be run before it can be chosen; empty where the settings alone make it
    made_by: str = ""

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
        """The quickest setting that looks the same, what less time takes away, and what pictures of a capture say."""
        same = [row for row in self.front if row.error.psnr_db >= LOOKS_SAME_DB]
        less = [row for row in self.front if not same or row.median_ms < same[0].median_ms]
        # of several that look alike the most exact one
        told = {row.looks: f"{row.median_ms:.0f} ms: {row.looks}{_after(row)}" for row in [*less, *same[:1]]}
        words = "; ".join([*told.values()][::-1][:3]) or "nothing can be chosen"
        near = next((row for row in self.choices if row.truth is not None and row.truth.as_near), None)
        if near is None or near.truth is None:
            return words
        gain = f"{near.truth.gain_db:+.2f} ± {near.truth.gain_error_db:.2f} dB"
        return (
            f"{words}. As near to {self.truth.split(' (')[0]} as preset reference: {near.name}, "
            f"{near.median_ms:.0f} ms ({gain}){_after(near)}"
        )

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
        """What can be chosen, every axis alone, passes of a scene's light, and growth."""
        rows = [row for axis in AXES[1:] for row in self.rows if row.axis == axis != LIGHT]
        lit = [row for row in self.rows if row.axis == LIGHT]
        found = [_table("What can be chosen", self.choices, self._notes())]
        if rows:
            found.append(_table("One thing changed alone, all else as preset final", rows, ()))
        if lit:
            found.append(_table("In the light of a scene, one of its passes left out", lit, LIGHT_NOTES))
        if self.growth:
            found.append(self._growth_table())
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
            "dB: whole picture over black, against the same hand drawn in float64 with nothing left out, its detail "
            f"added as the kernels draw it, {self.poses} poses together; worst: of any pixel and channel.",
            *(
                (
                    f"PSNR: mean and standard error against {self.truth}; gain: on the same pictures, against preset "
                    "reference.",
                )
                if self.truth
                else ()
            ),
            *(f"{row.name}: after `{row.made_by}`." for row in self.choices if row.made_by),
            f"ms: whole frame from joints to picture, nothing reused, no file read or written, {self.how_timed}.",
            *beaten,
            *((busy,) if self.disturbed else ()),
        )

    def _growth_table(self) -> Table:
        cells = tuple(
            (point.panel, f"{point.x:,}", _ms(point.median_ms, point.disturbed), _ms(point.p95_ms, point.disturbed))
            for point in self.growth
        )
        notes = (
            "Preset viewport, nothing reused, no filter of small hands. Poses in a batch: the bones of all of them in "
            "one call of torch.",
        )
        return Table("How time grows", ("With", "How many", "ms", "95 %"), cells, notes)


def _table(title: str, rows: Sequence[Row], notes: tuple[str, ...]) -> Table:
    cells = tuple(
        (
            row.name if row.axis == TOGETHER else f"{row.axis}: {row.name}",
            _ms(row.median_ms, row.disturbed),
            _ms(row.p95_ms, row.disturbed),
            number(row.error.psnr_db, 1),
            number(255 * row.error.worst, 1),
            *_truth_cells(row.truth),
            (f"● {row.looks}" if row.on_front else row.looks) or NONE,
        )
        for row in rows
    )
    return Table(title, ("Setting", "ms", "95 %", "dB", "Worst, 8-bit steps", "PSNR", "Gain", "Looks"), cells, notes)


def _truth_cells(truth: TruthScore | None) -> tuple[str, str]:
    if truth is None:
        return NONE, NONE
    return f"{truth.psnr_db:.2f} ± {truth.error_db:.2f}", f"{truth.gain_db:+.2f} ± {truth.gain_error_db:.2f}"


def _after(row: Row) -> str:
    return f", after `{row.made_by}`" if row.made_by else ""


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


def pareto_front(rows: Iterable[tuple[float, float, Named]]) -> list[Named]:
    """What no other is both faster and more accurate than, from the fastest on. rows: time, accuracy, and whose."""
    front: list[Named] = []
    best = -math.inf
    for _, accuracy, row in sorted(rows, key=lambda each: (each[0], -each[1])):
        if accuracy > best:
            front.append(row)
            best = accuracy
    return front


def how_it_looks(psnr_db: float, causes: Sequence[str]) -> str:
    """A few words for who does not know decibels. causes: what is left out, see `left_out`, the worst first."""
    if psnr_db >= LOOKS_SAME_DB:
        return "looks the same"
    # nothing else is left: correctives of a cheaper tier
    what = causes[0] if causes else APPROXIMATE
    if psnr_db >= LOOKS_ALIKE_DB:
        return f"nearly the same ({what})"
    return what if psnr_db >= LOOKS_CLOSE_DB else f"clearly {what}" if what.startswith("soft") else what


def left_out(settings: RenderSettings, total: int) -> dict[str, str]:
    """By axis, what one sees of settings that leave something out of an avatar of `total` Gaussians; of most first."""
    seen = {
        "correctives": "" if settings.effects.allows(Effect.CORRECTIVES) else "flat creases and knuckles",
        "detail": "" if settings.effects.allows(Effect.DETAIL) else "smooth skin",
        "Gaussians": "soft fingertips" if (settings.gaussians or total) < total else "",
        "shadow": "no shadow between the fingers" if settings.shadow is ShadowMode.OFF else "",
        "blend": "thin edges" if settings.alpha_min > contract.ALPHA_MIN else "",
    }
    return {axis: words for axis, words in seen.items() if words}
