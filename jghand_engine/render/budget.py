"""The best picture that so many milliseconds buy on this machine.

    chosen = best_for(16.0, avatar, (512, 334))
    renderer = HandRenderer(avatar, chosen.settings)

What settings cost is read from the profile of machine and avatar (`profile`). Where there is none for this size, two
seconds of drawing make one, on a motion of its own.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.color import decibels
from jghand_engine.errors import InputError
from jghand_engine.native.machine import FREE_PART, FreeCores
from jghand_engine.native.threads import thread_count
from jghand_engine.render.profile import (
    NO_CORRECTIVES,
    Profile,
    Rated,
    how_it_looks,
    left_out,
    pareto_front,
    read_profile,
    write_profile,
)
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS, RenderSettings, ShadowMode
from jghand_engine.render.subject import Subject, moving_subject

# part of a budget that 95 % of the measured frames may take: the rest is for whoever shows the image
BUDGET_PART = 0.9
# how long a machine that knows nothing of itself measures, seconds
BUDGET_SECONDS = 2.0
# images smaller than this lose more by half the size than by fewer Gaussians (built-in hand), pixels
HALF_PIXELS_MIN = 600_000

# poses whose accuracy is measured, and rounds of all settings at least
_POSES, _ROUNDS_MIN = 3, 5


@dataclass(frozen=True)
class Chosen:
    """rated: the settings and what was measured of them · fits: False when nothing is quick enough and this is the
    quickest · budget_ms: what was asked for · total: Gaussians of the avatar · profile: where it was found"""

    rated: Rated
    fits: bool
    budget_ms: float
    total: int
    profile: Profile

    @property
    def settings(self) -> RenderSettings:
        return self.rated.settings

    def sentence(self) -> str:
        """What was chosen and why, for the user."""
        row = self.rated
        looks = how_it_looks(row.psnr_db, list(left_out(row.settings, self.total).values()))
        told = f"{row.name}: {row.median_ms:.1f} ms (95 % below {row.p95_ms:.1f}), {row.psnr_db:.0f} dB, {looks}"
        busy = " while the machine had other work" if self.profile.disturbed else ""
        origin = f"({self.profile.origin}{busy})"
        if self.fits:
            return f"{self.budget_ms:g} ms buy {told} {origin}."
        return f"Nothing is drawn within {self.budget_ms:g} ms here; the quickest is {told} {origin}."


def candidates(avatar: HandAvatar, size_px: tuple[int, int]) -> dict[str, RenderSettings]:
    """Settings that are worth choosing from, by name: the presets, and what lies between and below them."""
    viewport, draft = PRESETS["viewport"], PRESETS["draft"]
    found = dict(PRESETS)
    if has_seen_shadow(avatar):
        found["final, shadow of 16 samples"] = replace(PRESETS["final"], shadow_samples=16)
        found["viewport, no shadow"] = replace(viewport, shadow=ShadowMode.OFF)
    for count, like in ((30_000, "viewport"), (30_000, "draft"), (20_000, "viewport"), (10_000, "draft")):
        if count < len(avatar):
            found[f"{like}, {count // 1000}k Gaussians"] = replace(PRESETS[like], gaussians=count)
    if avatar.learned is not None and avatar.learned.correctives is not None:
        found["viewport, no correctives"] = replace(viewport, effects=NO_CORRECTIVES)
        found["draft, no correctives"] = replace(draft, effects=NO_CORRECTIVES)
    if size_px[0] * size_px[1] >= HALF_PIXELS_MIN:
        found["viewport, half size"] = replace(viewport, half=True)
        found["draft, half size"] = replace(draft, half=True)
    return found


def has_seen_shadow(avatar: HandAvatar) -> bool:
    """Whether the avatar's shadow on itself is drawn where the pose asks for it."""
    look = ShadowLook() if avatar.learned is None else avatar.learned.shadow
    return look is not None and look.is_seen


def best_for(budget_ms: float, avatar: HandAvatar, size_px: tuple[int, int], threads: int = 0) -> Chosen:
    """The most accurate settings whose frames of that size take at most BUDGET_PART of `budget_ms` in 95 % of cases.

    threads: as in RenderSettings. InputError for a budget that is no time.
    """
    if not (math.isfinite(budget_ms) and budget_ms > 0):
        raise InputError("budget of a frame", wanted="milliseconds above 0", came=str(budget_ms))
    count = thread_count(threads)
    profile = read_profile(avatar, size_px, count)
    if profile is None or profile.disturbed:
        profile = measure_quickly(
            moving_subject(avatar.info.name, avatar, *size_px), candidates(avatar, size_px), count
        )
        # a disturbed measurement is better than none, and replaced by the next one
        write_profile(avatar, size_px, count, profile)
    return choose(profile, budget_ms, len(avatar), threads)


def choose(profile: Profile, budget_ms: float, total: int, threads: int = 0) -> Chosen:
    """See `best_for`. The settings that come out may reuse stages and have so many threads."""
    fitting = [row for row in profile.rows if row.p95_ms <= BUDGET_PART * budget_ms]
    front = pareto_front((row.p95_ms, row.psnr_db, row) for row in fitting)
    row = front[-1] if front else min(profile.rows, key=lambda each: each.p95_ms)
    return Chosen(
        replace(row, settings=replace(row.settings, threads=threads, reuse=True)),
        bool(front),
        budget_ms,
        total,
        profile,
    )


def measure_quickly(
    subject: Subject, offered: Mapping[str, RenderSettings], threads: int, seconds: float = BUDGET_SECONDS
) -> Profile:
    """Times of all settings in turn, and their accuracy against preset `reference`, in about so many seconds."""
    started = time.perf_counter()
    steady = {name: replace(one, threads=threads, reuse=False) for name, one in offered.items()}
    renderers = {name: HandRenderer(subject.avatar, one) for name, one in steady.items()}
    accuracy = _accuracy(subject, renderers, threads)
    times: dict[str, list[float]] = {name: [] for name in renderers}
    control, free = FreeCores(threads), []
    turn = 0
    try:
        while turn < _ROUNDS_MIN or time.perf_counter() - started < seconds:
            pose_m = subject.poses[turn % len(subject.poses)]
            free.append(control() >= FREE_PART * threads)
            for name, renderer in renderers.items():
                times[name].append(renderer.render(pose_m, subject.camera).report.total_ms)
            turn += 1
    finally:
        control.close()
    rows = tuple(
        Rated(name, offered[name], float(np.median(ms)), float(np.percentile(ms, 95)), accuracy[name])
        for name, ms in times.items()
    )
    return Profile(rows, f"measured in {seconds:g} s", disturbed=2 * sum(free) < len(free))


def _accuracy(subject: Subject, renderers: Mapping[str, HandRenderer], threads: int) -> dict[str, float]:
    """dB of some poses' pictures together; drawing them also warms everything up."""
    exact = HandRenderer(subject.avatar, replace(PRESETS["reference"], threads=threads))
    poses = subject.poses[np.linspace(0, len(subject.poses) - 1, _POSES).astype(int)]
    squares: dict[str, list[float]] = {name: [] for name in renderers}
    for pose_m in poses:
        wanted = exact.render(pose_m, subject.camera).rgba[..., :3]
        for name, renderer in renderers.items():
            squares[name].append(
                float(np.square(renderer.render(pose_m, subject.camera).rgba[..., :3] - wanted).mean())
            )
    return {name: decibels(float(np.mean(values))) for name, values in squares.items()}
