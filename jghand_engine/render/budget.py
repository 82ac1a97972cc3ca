"""The best image that so many milliseconds buy on this machine.

    chosen = best_for(16.0, avatar, (512, 334))
    renderer = HandRenderer(avatar, chosen.settings)

What settings cost, and how near they are to the most exact image, over black, stands in a small file per machine and
avatar in the user's cache folder; where nothing is known of a size, two seconds of drawing tell. A file that cannot be
read is as if it were not there.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import jghand_engine
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.avatar.learned_storage import LearnedAbout
from jghand_engine.avatar.tiers import Tier
from jghand_engine.color import decibels
from jghand_engine.errors import InputError, JGHandError
from jghand_engine.files import cache_folder, writing
from jghand_engine.gpu.choice import device_for
from jghand_engine.native.build import read_stamp
from jghand_engine.native.library import load
from jghand_engine.native.machine import FREE_PART, FreeCores, processor
from jghand_engine.native.threads import thread_count
from jghand_engine.render.effect_plan import CHOOSABLE, Choice, Effect
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import PRESETS, RenderSettings, ShadowMode
from jghand_engine.render.subject import Subject, moving_subject

# part of a budget that 95 % of the measured frames may take: the rest is for whoever shows the image
BUDGET_PART = 0.9
# how long a machine that knows nothing of itself measures, seconds; poses whose accuracy is measured; rounds at least
BUDGET_SECONDS = 2.0
_POSES, _ROUNDS_MIN = 3, 5
# of the file
FORMAT = 4
NO_CORRECTIVES, NO_DETAIL = (Choice(frozenset(CHOOSABLE) - {one}) for one in (Effect.CORRECTIVES, Effect.DETAIL))


@dataclass(frozen=True)
class Rated:
    """Settings, milliseconds of a whole frame in which nothing is reused, and accuracy, dB."""

    name: str
    settings: RenderSettings
    median_ms: float
    p95_ms: float
    psnr_db: float


@dataclass(frozen=True)
class Chosen:
    """settings: to draw with · name: of them · sentence: what was chosen and why, for the user"""

    settings: RenderSettings
    name: str
    sentence: str


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
    if avatar.learned is not None and avatar.learned.distilled is not None and avatar.learned.distilled.linear:
        taken = avatar.learned.with_tier(Tier.AUTO)[1]
        other = Tier.EXACT if taken is not None and taken.tier is Tier.LINEAR else Tier.LINEAR
        found["final, linear correctives"] = replace(PRESETS["final"], correctives=Tier.LINEAR)
        found[f"viewport, {other} correctives"] = replace(viewport, correctives=other)
    if avatar.learned is not None and avatar.learned.correctives is not None:
        found["viewport, no correctives"] = replace(viewport, effects=NO_CORRECTIVES)
        found["draft, no correctives"] = replace(draft, effects=NO_CORRECTIVES)
    if avatar.detail is not None:
        found["viewport, no detail"] = replace(viewport, effects=NO_DETAIL)
        found["draft, no detail"] = replace(draft, effects=NO_DETAIL)
    return found


def has_seen_shadow(avatar: HandAvatar) -> bool:
    """Whether the avatar's shadow on itself is drawn where the pose asks for it."""
    look = ShadowLook() if avatar.learned is None else avatar.learned.shadow
    return look is not None and look.is_seen


# ---- the choice -----------------------------------------------------------------------------------------------------


def best_for(
    budget_ms: float, avatar: HandAvatar, size_px: tuple[int, int], threads: int = 0, backend: str = "auto"
) -> Chosen:
    """The most accurate settings whose frames of that size take at most BUDGET_PART of `budget_ms` in 95 % of cases.

    threads, backend: as in RenderSettings. InputError for a budget that is no time.
    """
    if not (math.isfinite(budget_ms) and budget_ms > 0):
        raise InputError("budget of a frame", wanted="milliseconds above 0", came=str(budget_ms))
    count = thread_count(threads)
    rows, disturbed = read_profile(avatar, size_px, count, backend), False
    if rows is None:
        rows, disturbed = measure_quickly(
            moving_subject(avatar.info.name, avatar, *size_px), candidates(avatar, size_px), count, backend
        )
        # what was disturbed is measured again the next time
        if not disturbed:
            write_profile(avatar, size_px, count, rows, backend)
    chosen = choose(rows, budget_ms, disturbed=disturbed, threads=threads)
    return replace(chosen, settings=replace(chosen.settings, backend=backend))


def choose(rows: Sequence[Rated], budget_ms: float, *, disturbed: bool = False, threads: int = 0) -> Chosen:
    """See `best_for`. The settings that come out may reuse stages and have so many threads. disturbed: whether the
    machine had other work while the rows were measured."""
    fitting = [row for row in rows if row.p95_ms <= BUDGET_PART * budget_ms]
    quickest = min(rows, key=lambda row: row.p95_ms)
    row = max(fitting, key=lambda row: (row.psnr_db, -row.p95_ms), default=quickest)
    lead = f"{budget_ms:g} ms buy" if fitting else f"Nothing is drawn within {budget_ms:g} ms here; the quickest is"
    words = f"{row.name}: {row.median_ms:.1f} ms (95 % below {row.p95_ms:.1f}), {row.psnr_db:.0f} dB"
    busy = ", measured while the machine had other work" if disturbed else ""
    return Chosen(replace(row.settings, threads=threads, reuse=True), row.name, f"{lead} {words}{busy}.")


# ---- the measurement ------------------------------------------------------------------------------------------------


def measure_quickly(
    subject: Subject,
    offered: Mapping[str, RenderSettings],
    threads: int,
    backend: str = "auto",
    seconds: float = BUDGET_SECONDS,
) -> tuple[tuple[Rated, ...], bool]:
    """Times of all settings in turn, and their accuracy against preset `reference`, in about so many seconds; and
    whether the machine had other work meanwhile."""
    started = time.perf_counter()
    steady = {name: replace(one, threads=threads, backend=backend, reuse=False) for name, one in offered.items()}
    renderers = {name: HandRenderer(subject.avatar, one) for name, one in steady.items()}
    accuracy = _accuracy(subject, renderers, threads)
    times: dict[str, list[float]] = {name: [] for name in renderers}
    free: list[bool] = []
    with contextlib.closing(FreeCores(threads)) as control:
        while len(free) < _ROUNDS_MIN or time.perf_counter() - started < seconds:
            pose_m = subject.poses[len(free) % len(subject.poses)]
            free.append(control() >= FREE_PART * threads)
            for name, renderer in renderers.items():
                times[name].append(renderer.render(pose_m, subject.camera).report.total_ms)
    rows = tuple(
        Rated(name, offered[name], float(np.median(ms)), float(np.percentile(ms, 95)), accuracy[name])
        for name, ms in times.items()
    )
    return rows, 2 * sum(free) < len(free)


def _accuracy(subject: Subject, renderers: Mapping[str, HandRenderer], threads: int) -> dict[str, float]:
    """dB of some poses' images together; drawing them also warms everything up."""
    exact = HandRenderer(subject.avatar, replace(PRESETS["reference"], threads=threads))
    squares: dict[str, list[float]] = {name: [] for name in renderers}
    for pose_m in subject.poses[np.linspace(0, len(subject.poses) - 1, _POSES).astype(int)]:
        wanted = exact.render(pose_m, subject.camera).rgba[..., :3]
        for name, renderer in renderers.items():
            error = renderer.render(pose_m, subject.camera).rgba[..., :3] - wanted
            squares[name].append(float(np.square(error).mean()))
    return {name: decibels(float(np.mean(values))) for name, values in squares.items()}


# ---- the file -------------------------------------------------------------------------------------------------------


def profile_file(avatar: HandAvatar, backend: str = "auto") -> Path:
    """Where the profile of this machine, what draws on it, and avatar is, whether it is there or not."""
    library = load(backend)
    device = device_for(backend, library)
    machine = [
        processor(),
        platform.machine(),
        os.cpu_count(),
        library.variant,
        repr(read_stamp(library.path)),
        None if device is None else device.name,
    ]
    learned = None if avatar.learned is None else asdict(LearnedAbout.of(avatar.learned))
    digest = hashlib.sha256(json.dumps([FORMAT, jghand_engine.__version__, *machine, learned]).encode())
    detail = () if avatar.detail is None else (avatar.detail.texture,)
    if avatar.detail is not None and avatar.detail.relief is not None:
        detail += (avatar.detail.relief.height,)
    for array in (avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb, *detail):
        digest.update(array.tobytes())
    return cache_folder() / f"profile_{digest.hexdigest()[:24]}.json"


def read_profile(
    avatar: HandAvatar, size_px: tuple[int, int], threads: int, backend: str = "auto"
) -> tuple[Rated, ...] | None:
    """What is known of the candidates for images of that size and so many threads; None for nothing."""
    offered = candidates(avatar, size_px)
    try:
        known = _read(profile_file(avatar, backend))[_key(size_px, threads)].items()
        rows = tuple(Rated(name, offered[name], *map(float, figures)) for name, figures in known)
        return rows if rows and all(math.isfinite(row.p95_ms + row.psnr_db) for row in rows) else None
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def write_profile(
    avatar: HandAvatar, size_px: tuple[int, int], threads: int, rows: Sequence[Rated], backend: str = "auto"
) -> None:
    """Adds it to the file, whole or not at all: where it cannot be written, that costs only the next two seconds."""
    figures = {row.name: (row.median_ms, row.p95_ms, row.psnr_db) for row in rows}
    file = profile_file(avatar, backend)
    content = _read(file) | {_key(size_px, threads): figures}
    with contextlib.suppress(JGHandError, OSError), writing(file) as temporary:
        temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _key(size_px: tuple[int, int], threads: int) -> str:
    return f"{size_px[0]}x{size_px[1]}, {threads} threads"


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
