"""The best image that so many milliseconds buy on this machine.

    chosen = best_for(16.0, avatar, (512, 334))
    renderer = HandRenderer(avatar, chosen.settings)

What settings cost, and how near they are to the most exact image, over black, stands in a small file per machine and
avatar in the user's cache folder. `jghand study accuracy` fills it thoroughly; where nothing is known of a size, two
seconds of drawing do. A file that cannot be read is as if it were not there.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

import jghand_engine
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.avatar.learned_storage import LearnedAbout
from jghand_engine.avatar.tiers import Tier
from jghand_engine.color import decibels
from jghand_engine.errors import InputError, JGHandError
from jghand_engine.files import cache_folder, writing
from jghand_engine.native import contract
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
# accuracy of a whole image over black from which on an artist sees no difference, has to look for it, sees it at once
LOOKS_SAME_DB = 45.0
LOOKS_ALIKE_DB = 38.0
LOOKS_CLOSE_DB = 30.0

# of the file
FORMAT = 3
APPROXIMATE = "approximate creases"
NO_CORRECTIVES, NO_DETAIL = (Choice(frozenset(CHOOSABLE) - {one}) for one in (Effect.CORRECTIVES, Effect.DETAIL))

Row = TypeVar("Row")


@dataclass(frozen=True)
class Rated:
    """Settings, milliseconds of a whole frame in which nothing is reused, and accuracy, dB."""

    name: str
    settings: RenderSettings
    median_ms: float
    p95_ms: float
    psnr_db: float


@dataclass(frozen=True)
class Profile:
    """rows: what was measured · origin: in words, how · disturbed: whether the machine had other work meanwhile"""

    rows: tuple[Rated, ...]
    origin: str
    disturbed: bool = False


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


def best_for(budget_ms: float, avatar: HandAvatar, size_px: tuple[int, int], threads: int = 0) -> Chosen:
    """The most accurate settings whose frames of that size take at most BUDGET_PART of `budget_ms` in 95 % of cases.

    threads: as in RenderSettings. InputError for a budget that is no time.
    """
    if not (math.isfinite(budget_ms) and budget_ms > 0):
        raise InputError("budget of a frame", wanted="milliseconds above 0", came=str(budget_ms))
    count = thread_count(threads)
    profile = read_profile(avatar, size_px, count)
    if profile is None:
        profile = measure_quickly(
            moving_subject(avatar.info.name, avatar, *size_px), candidates(avatar, size_px), count
        )
        write_profile(avatar, size_px, count, profile)
    return choose(profile, budget_ms, len(avatar), threads)


def choose(profile: Profile, budget_ms: float, total: int, threads: int = 0) -> Chosen:
    """See `best_for`. The settings that come out may reuse stages and have so many threads. total: Gaussians of the
    avatar."""
    fitting = [row for row in profile.rows if row.p95_ms <= BUDGET_PART * budget_ms]
    front = pareto_front((row.p95_ms, row.psnr_db, row) for row in fitting)
    row = front[-1] if front else min(profile.rows, key=lambda each: each.p95_ms)
    looks = how_it_looks(row.psnr_db, list(left_out(row.settings, total).values()))
    words = f"{row.name}: {row.median_ms:.1f} ms (95 % below {row.p95_ms:.1f}), {row.psnr_db:.0f} dB, {looks}"
    busy = " while the machine had other work" if profile.disturbed else ""
    lead = f"{budget_ms:g} ms buy" if front else f"Nothing is drawn within {budget_ms:g} ms here; the quickest is"
    settings = replace(row.settings, threads=threads, reuse=True)
    return Chosen(settings, row.name, f"{lead} {words} ({profile.origin}{busy}).")


def pareto_front(rows: Iterable[tuple[float, float, Row]]) -> list[Row]:
    """What no other is both faster and more accurate than, from the fastest on. rows: time, accuracy, and whose."""
    front: list[Row] = []
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


# ---- the measurement ------------------------------------------------------------------------------------------------


def measure_quickly(
    subject: Subject, offered: Mapping[str, RenderSettings], threads: int, seconds: float = BUDGET_SECONDS
) -> Profile:
    """Times of all settings in turn, and their accuracy against preset `reference`, in about so many seconds."""
    started = time.perf_counter()
    steady = {name: replace(one, threads=threads, reuse=False) for name, one in offered.items()}
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
    return Profile(rows, f"measured in {seconds:g} s", disturbed=2 * sum(free) < len(free))


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


def profile_file(avatar: HandAvatar) -> Path:
    """Where the profile of this machine and avatar is, whether it is there or not."""
    library = load("auto")
    machine = [processor(), platform.machine(), os.cpu_count(), library.variant, repr(read_stamp(library.path))]
    learned = None if avatar.learned is None else LearnedAbout.of(avatar.learned).as_dict()
    digest = hashlib.sha256(json.dumps([FORMAT, jghand_engine.__version__, *machine, learned]).encode())
    detail = () if avatar.detail is None else (avatar.detail.texture,)
    for array in (avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb, *detail):
        digest.update(array.tobytes())
    return cache_folder() / f"profile_{digest.hexdigest()[:24]}.json"


def read_profile(avatar: HandAvatar, size_px: tuple[int, int], threads: int) -> Profile | None:
    """What is known of the candidates for images of that size and so many threads; None for nothing."""
    offered = candidates(avatar, size_px)
    try:
        entry = _read(profile_file(avatar))[_key(size_px, threads)]
        rows = tuple(Rated(name, offered[name], *map(float, figures)) for name, figures in entry["rows"].items())
        sound = all(math.isfinite(row.median_ms + row.p95_ms + row.psnr_db) for row in rows)
        return Profile(rows, str(entry["origin"])) if rows and sound else None
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def write_profile(avatar: HandAvatar, size_px: tuple[int, int], threads: int, profile: Profile) -> bool:
    """Adds it to the file, whole or not at all; False when it cannot be written or was disturbed, which costs only the
    next two seconds."""
    rows = {row.name: (row.median_ms, row.p95_ms, row.psnr_db) for row in profile.rows}
    file = profile_file(avatar)
    content = _read(file) | {_key(size_px, threads): {"origin": profile.origin, "rows": rows}}
    with contextlib.suppress(JGHandError, OSError):
        if not profile.disturbed:
            with writing(file) as temporary:
                temporary.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")
            return True
    return False


def _key(size_px: tuple[int, int], threads: int) -> str:
    return f"{size_px[0]}x{size_px[1]}, {threads} threads"


def _read(file: Path) -> dict[str, Any]:
    try:
        content = json.loads(file.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}
