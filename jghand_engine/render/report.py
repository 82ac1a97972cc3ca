"""What a frame did: stages run and skipped, why, how long each took, and how wrong a skip can be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jghand_engine.render.effect_plan import Effect, EffectPlan

# effects that are stages of their own; the others are parts of stages
STAGE_OF_EFFECT = {
    Effect.SKIN: "skin",
    Effect.SHADOW: "shadow + compose",
    Effect.NORMALS: "normals",
    Effect.IDS: "ids",
}


@dataclass(frozen=True)
class Stage:
    """One stage of a frame. `bound` says in words how far the picture can differ because of a skip."""

    name: str
    ran: bool
    milliseconds: float = 0.0
    reason: str = ""
    bound: str = ""

    def line(self) -> str:
        """One line of the receipt: `skin skipped: joints moved 0.01 mm (0.2 mm of skin)`."""
        if self.ran:
            return f"{self.name} ran, {self.milliseconds:.2f} ms" + (f": {self.reason}" if self.reason else "")
        return f"{self.name} skipped: {self.reason}" + (f" ({self.bound})" if self.bound else "")


@dataclass
class FrameReport:
    """The receipt that comes with every picture.

    invalid_gaussians: not drawable, left out · visible_gaussians: drawn · gaussians: posed · notes: what was unusual
    about the hand · backend: the variant of the kernels · plan: which effects were decided to run
    """

    stages: list[Stage] = field(default_factory=list)
    total_ms: float = 0.0
    invalid_gaussians: int = 0
    visible_gaussians: int = 0
    gaussians: int = 0
    notes: list[str] = field(default_factory=list)
    backend: str = ""
    threads: int = 1
    plan: EffectPlan | None = None

    def ran(self, name: str, milliseconds: float, reason: str = "") -> None:
        """Adds a stage, or the time of running it again."""
        for place, one in enumerate(self.stages):
            if one.name == name:
                again = one.milliseconds + milliseconds
                self.stages[place] = Stage(name, True, again, reason or (one.reason if one.ran else ""))
                return
        self.stages.append(Stage(name, True, milliseconds, reason))

    def skipped(self, name: str, reason: str, bound: str) -> None:
        """Adds a stage, unless it is there already: what was skipped once may have run before or after."""
        if self.stage(name) is None:
            self.stages.append(Stage(name, False, 0.0, reason, bound))

    def explain(self, name: str, reason: str) -> None:
        """Gives a stage that ran a reason; a stage that did not keeps its own."""
        self.stages = [replace(one, reason=reason) if one.name == name and one.ran else one for one in self.stages]

    def stage(self, name: str) -> Stage | None:
        """The stage of that name, if the frame came to it."""
        return next((stage for stage in self.stages if stage.name == name), None)

    def lines(self) -> list[str]:
        """The receipt in words."""
        total = f"frame {self.total_ms:.2f} ms, {self.backend}, {self.threads} thread{'s' if self.threads > 1 else ''}"
        counts = f"{self.visible_gaussians} of {self.gaussians} Gaussians drawn, {self.invalid_gaussians} invalid"
        planned = [] if self.plan is None else [one.line(self.effect_ms(one.effect)) for one in self.plan.decisions]
        return [total, counts, *planned, *(stage.line() for stage in self.stages), *self.notes]

    def effect_ms(self, effect: Effect) -> float | None:
        """What the effect took, where it is a stage of its own; None else."""
        stage = self.stage(STAGE_OF_EFFECT.get(effect, ""))
        return stage.milliseconds if stage is not None and stage.ran else None

    def as_dict(self) -> dict:
        """Plain data for JSON and for the wire."""
        return {
            "total_ms": self.total_ms,
            "backend": self.backend,
            "threads": self.threads,
            "gaussians": self.gaussians,
            "visible_gaussians": self.visible_gaussians,
            "invalid_gaussians": self.invalid_gaussians,
            "notes": list(self.notes),
            "stages": [vars(stage) for stage in self.stages],
            "effects": [] if self.plan is None else [one.as_dict() for one in self.plan.decisions],
        }


def summed(reports: Sequence[FrameReport], plan: EffectPlan | None) -> FrameReport:
    """One receipt of all images of a mean: times are added, notes said once, the rest is that of the last one."""
    whole = replace(reports[-1], stages=[], notes=[], plan=plan)
    for report in reports:
        for stage in report.stages:
            if stage.ran:
                whole.ran(stage.name, stage.milliseconds, stage.reason)
            else:
                whole.skipped(stage.name, stage.reason, stage.bound)
    whole.notes = list(dict.fromkeys(note for report in reports for note in report.notes))
    whole.total_ms = sum(report.total_ms for report in reports)
    return whole


class EffectSums:
    """Receipts of many frames, summed up."""

    def __init__(self) -> None:
        self._sums: dict[str, dict[str, Any]] = {}

    def add(self, report: FrameReport) -> None:
        """Adds one frame's."""
        for one in () if report.plan is None else report.plan.decisions:
            empty = {"ran": 0, "skipped": 0, "saved_ms": 0.0, "ms": 0.0, "reason": ""}
            entry = self._sums.setdefault(str(one.effect), empty)
            if one.runs:
                measured_ms = report.effect_ms(one.effect)
                entry["ran"] += 1
                entry["ms"] += one.estimated_ms if measured_ms is None else measured_ms
            else:
                entry["skipped"] += 1
                entry["saved_ms"] += one.estimated_ms
                entry["reason"] = one.reason

    def figures(self) -> dict[str, dict[str, Any]]:
        """By effect: frames it ran on and was skipped on, the last reason why, ms that it took (measured where it is a
        stage of its own, else estimated) and that skipping it saved (estimated)."""
        return self._sums
