"""What a frame did: stages that ran and how long each took, effects that ran or did not, why, and what that loses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from jghand_engine.render.effect_plan import Effect, EffectPlan

# effects that are stages of their own; the others are parts of stages
STAGE_OF_EFFECT = {
    Effect.SKIN: "skin",
    Effect.DETAIL: "detail",
    Effect.SHADOW: "shadow + compose",
    Effect.GLOSS: "gloss",
    Effect.SHARP_SHADOW: "lamp pictures",
}


@dataclass
class FrameReport:
    """The receipt that comes with every image.

    stages:            milliseconds of what ran, by name, in its order
    total_ms:          the whole frame
    invalid_gaussians: not drawable, left out
    visible_gaussians: drawn
    gaussians:         posed
    notes:             what was unusual about the hand
    backend:           the variant of the kernels, and the graphics card if one drew it
    threads:           how many drew
    tier:              which correctives were used, in words; empty without any
    plan:              which effects were decided to run
    """

    stages: dict[str, float] = field(default_factory=dict)
    total_ms: float = 0.0
    invalid_gaussians: int = 0
    visible_gaussians: int = 0
    gaussians: int = 0
    notes: list[str] = field(default_factory=list)
    backend: str = ""
    threads: int = 1
    tier: str = ""
    plan: EffectPlan | None = None

    def ran(self, name: str, milliseconds: float) -> None:
        """Adds a stage, or the time of running it again."""
        self.stages[name] = self.stages.get(name, 0.0) + milliseconds

    def lines(self) -> list[str]:
        """The receipt in words."""
        total = f"frame {self.total_ms:.2f} ms, {self.backend}, {self.threads} thread{'s' if self.threads > 1 else ''}"
        counts = f"{self.visible_gaussians} of {self.gaussians} Gaussians drawn, {self.invalid_gaussians} invalid"
        planned = [] if self.plan is None else [one.line(self.effect_ms(one.effect)) for one in self.plan.decisions]
        stages = [f"{name} ran, {spent_ms:.2f} ms" for name, spent_ms in self.stages.items()]
        return [total, counts, *([self.tier] if self.tier else []), *planned, *stages, *self.notes]

    def effect_ms(self, effect: Effect) -> float | None:
        """What the effect took, where it is a stage of its own; None else."""
        return self.stages.get(STAGE_OF_EFFECT.get(effect, ""))

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON and for the wire."""
        reasons = {"skin": self.tier}
        stages = [
            {"name": name, "ran": True, "milliseconds": spent_ms, "reason": reasons.get(name, "")}
            for name, spent_ms in self.stages.items()
        ]
        effects = [] if self.plan is None else [one.as_dict() for one in self.plan.decisions]
        plain = {name: value for name, value in vars(self).items() if name not in ("tier", "plan")}
        return plain | {"notes": list(self.notes), "stages": stages, "effects": effects}


def summed(reports: Sequence[FrameReport], plan: EffectPlan | None) -> FrameReport:
    """One receipt of all images of a mean: times are added, notes said once, the rest is that of the last one."""
    if len(reports) == 1:
        return replace(reports[0], plan=plan)
    notes = dict.fromkeys(note for report in reports for note in report.notes)
    whole = replace(reports[-1], stages={}, notes=list(notes), plan=plan)
    for report in reports:
        for name, spent_ms in report.stages.items():
            whole.ran(name, spent_ms)
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
