"""Honest times: interleaved, after warm-up, and only while the machine is ours (RENDERING 9.2).

A case that is measured alone sees a different machine than the next one a minute later; so the cases take turns. On a
shared machine a neighbor can take a core: before and after every sample two independent loops tell how many cores
there really were, and disturbed samples are dropped.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jghand_engine.native.machine import FREE_PART, FreeCores
from jghand_engine.render.report import FrameReport


@dataclass(frozen=True)
class Case:
    """One thing to be timed. run: called once per sample; a FrameReport that it returns gives the times of stages.

    rounds: 0 = as many as the others; slow references get few · threads: cores that must be free
    """

    section: str
    name: str
    run: Callable[[], FrameReport | None]
    rounds: int = 0
    threads: int = 2


@dataclass(frozen=True)
class Measurement:
    """Milliseconds of one case. dropped: samples during which the machine was not free; when nearly all were, they are
    kept and `disturbed` says so. cpu_ms: processor time of all threads, median; None for a stage."""

    section: str
    name: str
    median_ms: float
    p95_ms: float
    cpu_ms: float | None
    samples: int
    dropped: int
    disturbed: bool

    def as_dict(self) -> dict[str, Any]:
        """Plain data for JSON, which has no NaN."""
        return {name: None if value != value else value for name, value in vars(self).items()}


@dataclass
class _Samples:
    wall: list[float] = field(default_factory=list)
    cpu: list[float] = field(default_factory=list)
    free: list[bool] = field(default_factory=list)
    stages: list[dict[str, float]] = field(default_factory=list)


def measure(
    cases: Sequence[Case], *, rounds: int, warm_up: int, enough: int = 10, tick: Callable[[], None] | None = None
) -> list[Measurement]:
    """Times all cases in turn, `rounds` times after `warm_up` untimed turns. Stages of frames follow their case.

    enough: with fewer undisturbed samples than this all are used, and marked · tick: called after every round
    """
    samples = [_Samples() for _ in cases]
    controls = {threads: FreeCores(threads) for threads in {case.threads for case in cases}}
    try:
        for turn in range(warm_up + rounds):
            for case, sample in zip(cases, samples, strict=True):
                wanted = case.rounds or rounds
                # slow ones warm up once, and are spread over the first rounds
                if turn >= warm_up + wanted or turn < warm_up - (1 if case.rounds else warm_up):
                    continue
                _take(case, sample if turn >= warm_up else _Samples(), controls[case.threads])
            if tick:
                tick()
    finally:
        for control in controls.values():
            control.close()
    return [line for case, sample in zip(cases, samples, strict=True) for line in _lines(case, sample, enough)]


def _take(case: Case, sample: _Samples, control: FreeCores) -> None:
    before = control()
    wall, cpu = time.perf_counter(), time.process_time()
    report = case.run()
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    free = min(before, control()) >= FREE_PART * case.threads
    sample.wall.append(1e3 * wall)
    sample.cpu.append(1e3 * cpu)
    sample.free.append(free)
    sample.stages.append(dict(report.stages) if report else {})


def _lines(case: Case, sample: _Samples, enough: int) -> Iterable[Measurement]:
    free = np.array(sample.free, bool)
    disturbed = int(free.sum()) < min(enough, len(free))
    keep = np.ones_like(free) if disturbed else free

    def line(name: str, values: list[float], cpu: list[float] | None) -> Measurement:
        kept = np.array(values)[keep]
        return Measurement(
            section=case.section,
            name=name,
            median_ms=float(np.median(kept)),
            p95_ms=float(np.percentile(kept, 95)),
            cpu_ms=float(np.median(np.array(cpu)[keep])) if cpu else None,
            samples=len(kept),
            dropped=int((~keep).sum()),
            disturbed=disturbed,
        )

    yield line(case.name, sample.wall, sample.cpu)
    for stage in dict.fromkeys(name for frame in sample.stages for name in frame):
        # a stage that a frame did not come to took nothing there
        yield line(f"  {stage}", [frame.get(stage, 0.0) for frame in sample.stages], None)
