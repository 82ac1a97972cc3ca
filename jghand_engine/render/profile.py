"""What settings cost and give on this machine: a small file per machine and avatar in the user's cache folder.

Times are of pictures of one size with so many threads; accuracy is that of the picture, over black, against the most
exact one. `jghand study accuracy` fills it thoroughly, `budget` in two seconds. What cannot be read is as if it were
not there.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import platform
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import jghand_engine
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned_storage import LearnedAbout, pack_learned
from jghand_engine.avatar.storage import Storage
from jghand_engine.avatar.tiers import Tier
from jghand_engine.errors import InputError, JGHandError
from jghand_engine.files import cache_folder, writing
from jghand_engine.native import contract
from jghand_engine.native.build import read_stamp
from jghand_engine.native.library import load
from jghand_engine.native.machine import processor
from jghand_engine.render.effect_plan import CHOOSABLE, Choice, Effect
from jghand_engine.render.settings import RenderSettings, ShadowMode

# accuracy of a whole image over black from which on an artist sees no difference, has to look for it, sees it at once
LOOKS_SAME_DB = 45.0
LOOKS_ALIKE_DB = 38.0
LOOKS_CLOSE_DB = 30.0

FORMAT = 1
APPROXIMATE = "approximate creases"
NO_CORRECTIVES = Choice(frozenset(CHOOSABLE) - {Effect.CORRECTIVES})


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
    disturbed: bool


Row = TypeVar("Row")


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
    count = settings.gaussians or total
    seen = {
        "resolution": "soft everywhere" if settings.half else "",
        "correctives": "" if settings.effects.allows(Effect.CORRECTIVES) else "flat creases and knuckles",
        "Gaussians": "soft fingertips" if count < total else "",
        "shadow": "no shadow between the fingers" if settings.shadow is ShadowMode.OFF else "",
        "blend": "thin edges" if settings.alpha_min > contract.ALPHA_MIN else "",
    }
    return {axis: words for axis, words in seen.items() if words}


# ---- the file -------------------------------------------------------------------------------------------------------


def profile_file(avatar: HandAvatar) -> Path:
    """Where the profile of this machine and avatar is, whether it is there or not."""
    library = load("auto")
    stamp = read_stamp(library.path)
    machine = [processor(), platform.machine(), os.cpu_count(), library.variant, repr(stamp)]
    digest = hashlib.sha256(json.dumps([FORMAT, jghand_engine.__version__, *machine]).encode())
    for array in (avatar.position_m, avatar.sigma_m, avatar.opacity, avatar.rgb):
        digest.update(array.tobytes())
    if avatar.learned is not None:
        learned = avatar.learned
        digest.update(json.dumps(LearnedAbout.of(learned).as_dict(), sort_keys=True).encode())
        for name, array in sorted(pack_learned(learned, Storage.COMPACT).items()):
            digest.update(name.encode() + array.tobytes())
    return cache_folder() / f"profile_{digest.hexdigest()[:24]}.json"


def read_profile(avatar: HandAvatar, size_px: tuple[int, int], threads: int) -> Profile | None:
    """What is known for pictures of that size and so many threads; None for nothing."""
    entry = _read(profile_file(avatar)).get(_key(size_px, threads))
    if not isinstance(entry, dict):
        return None
    try:
        rows = tuple(_rated(row) for row in entry["rows"])
        return Profile(rows, str(entry["origin"]), bool(entry["disturbed"])) if rows else None
    except (KeyError, TypeError, ValueError, InputError):
        return None


def write_profile(avatar: HandAvatar, size_px: tuple[int, int], threads: int, profile: Profile) -> bool:
    """Adds it to the file, whole or not at all; False when it cannot be written, which costs only the next two
    seconds."""
    file = profile_file(avatar)
    content = _read(file) | {
        _key(size_px, threads): {
            "origin": profile.origin,
            "disturbed": profile.disturbed,
            "rows": [_plain(row) for row in profile.rows],
        }
    }
    with contextlib.suppress(JGHandError, OSError):
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


# settings that differ between rows; the others are those of whoever draws
_NUMBERS = {"gaussians": int, "alpha_min": float, "t_stop": float, "shadow_samples": int, "half": bool}


def _plain(row: Rated) -> dict[str, Any]:
    settings = row.settings
    return {
        "name": row.name, "median_ms": row.median_ms, "p95_ms": row.p95_ms, "psnr_db": row.psnr_db,
        **{name: getattr(settings, name) for name in _NUMBERS}, "shadow": str(settings.shadow),
        "tier": str(settings.correctives), "correctives": settings.effects.allows(Effect.CORRECTIVES),
    }  # fmt: skip


def _rated(row: dict[str, Any]) -> Rated:
    settings = replace(
        RenderSettings(**{name: kind(row[name]) for name, kind in _NUMBERS.items()}),
        shadow=ShadowMode(row["shadow"]),
        correctives=Tier(row["tier"]),
        effects=Choice() if row["correctives"] else NO_CORRECTIVES,
    )
    times = [float(row[name]) for name in ("median_ms", "p95_ms", "psnr_db")]
    if not all(map(math.isfinite, times)):
        raise ValueError("a figure that is no number")
    return Rated(str(row["name"]), settings, *times)
