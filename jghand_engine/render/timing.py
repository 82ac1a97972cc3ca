"""Times of frames: interleaved, after warm-up, and only while the machine is ours (RENDERING 9.2).

A case that is measured alone sees a different machine than the next one a minute later; so the cases take turns. On a
shared machine a neighbor can take a core: before and after every sample two independent loops tell how many cores
there really were, and disturbed samples are dropped. A frame is run end to end, never the sum of its stages; files and
sockets are not part of it.
"""

from __future__ import annotations

import itertools
import os
import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from jghand_engine.errors import RetryError
from jghand_engine.native.build import read_stamp
from jghand_engine.native.library import load
from jghand_engine.native.machine import FREE_PART, FreeCores, processor
from jghand_engine.native.rasterizer import DRAWN_HERE
from jghand_engine.native.threads import thread_count
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.report import FrameReport
from jghand_engine.render.settings import RenderSettings
from jghand_engine.render.subject import Subject

# heads of the columns of `table_rows`
COLUMNS = ("", "median ms", "p95 ms", "CPU ms", "samples")


@dataclass(frozen=True)
class Case:
    """One thing to be timed."""

    section: str
    name: str
    # called once per sample; a FrameReport that it returns gives the times of stages
    run: Callable[[], FrameReport | None]
    # 0: as many as the others; slow references get few
    rounds: int = 0
    # cores that must be free
    threads: int = 2


@dataclass(frozen=True)
class Measurement:
    """Milliseconds of one case."""

    section: str
    name: str
    median_ms: float
    p95_ms: float
    # processor time of all threads, median; None for a stage
    cpu_ms: float | None
    samples: int
    # samples during which the machine was not free
    dropped: int
    # nearly all samples were: they are kept
    disturbed: bool


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


# ---- frames ----------------------------------------------------------------------------------------------------------


def frame_case(subject: Subject, settings: RenderSettings, section: str) -> Case:
    """Whole frames of a hand in motion, from joints to picture, with their stages. Where a graphics card leaves one to
    the processor, RetryError: it would be told as the card's."""
    renderer, poses = HandRenderer(subject.avatar, settings), itertools.cycle(subject.poses)

    def run() -> FrameReport:
        report = renderer.render(next(poses), subject.camera).report
        if failed := [note for note in report.notes if note.startswith(DRAWN_HERE)]:
            raise RetryError("measurement", wanted="frames that the graphics card draws", came=failed[0])
        return report

    return Case(section, title_of(subject), run, threads=thread_count(settings.threads))


def title_of(subject: Subject) -> str:
    return f"{subject.name}, {subject.camera.width} x {subject.camera.height}"


def machine(threads: int, backend: str = "auto") -> dict[str, Any]:
    """Hardware, threads, variant of the kernels and compiler, for the head of a table. threads, backend: as in
    RenderSettings"""
    library = load(backend)
    stamp = read_stamp(library.path)
    return {
        "processor": processor(),
        "cores": os.cpu_count(),
        "threads": thread_count(threads),
        "backend": library.variant,
        "compiler": stamp.compiler if stamp else "",
        "python": platform.python_version(),
        "system": platform.platform(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def table_rows(measurements: Sequence[Measurement]) -> list[tuple[str, ...]]:
    """Rows under COLUMNS: every section, then its cases."""
    rows: list[tuple[str, ...]] = []
    for section in dict.fromkeys(one.section for one in measurements):
        rows.append((section, "", "", "", ""))
        for one in measurements:
            if one.section == section:
                samples = f"{one.samples}" + (f" of {one.samples + one.dropped}" if one.dropped else "")
                cpu = "" if one.cpu_ms is None else f"{one.cpu_ms:.2f}"
                mark = " disturbed" if one.disturbed else ""
                rows.append((f"  {one.name}", f"{one.median_ms:.2f}", f"{one.p95_ms:.2f}", cpu, samples + mark))
    return rows
