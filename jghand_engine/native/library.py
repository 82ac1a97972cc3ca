"""Loading the native library: which variant, is it up to date, does it compute what it should.

Nothing here fails because there is no native library: then `load` returns None after a line that says why, and the
torch reference draws the same picture, slower. Only a variant that was asked for by name is an error when missing.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from pathlib import Path

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.native import build, selftest
from jghand_engine.native.binding import Library, open_library

VARIANTS = ("v4", "v3", "neon")
BACKENDS = ("auto", "torch", *VARIANTS)

# ---- choice of variant ----------------------------------------------------------------------------------------------


def best_variant() -> str | None:
    """The fastest variant this machine can run, or None (with no library for this platform, or an old processor)."""
    platform = build.host_platform()
    if f"{platform}_neon" in build.TARGETS:
        return "neon"
    if f"{platform}_detector" not in build.TARGETS:
        return None
    detector = ctypes.CDLL(str(_current_library("detector")))
    detector.jg_x86_64_level.restype = ctypes.c_int
    return {4: "v4", 3: "v3"}.get(detector.jg_x86_64_level())


def runnable_variants() -> list[str]:
    """Every native variant that can run here, the fastest first."""
    best = best_variant()
    return {"v4": ["v4", "v3"], None: []}.get(best, [best] if best else [])


def _current_library(variant: str) -> Path:
    """The path of a library of these sources; builds it when it is missing or stale and a compiler is there.

    Which compiler built it does not matter here: one that is named in JGHAND_CXX need not be on this machine.
    """
    target = build.TARGETS.get(f"{build.host_platform()}_{variant}")
    if target is None:
        raise InputError("native variant", wanted=f"one for {build.host_platform()}", came=variant)
    folder = build.LIBRARY_FOLDER
    path = folder / target.file_name
    if build.has_these_sources(target, folder):
        return path
    state = "was built from other sources" if path.exists() else "is missing"
    try:
        return build.build(target, folder)
    except JGHandError as error:
        raise RetryError(f"native library {path.name} {state} and could not be built", remedy=str(error)) from error


# ---- loading --------------------------------------------------------------------------------------------------------

_loaded: dict[str, Library | None] = {}
_lock = threading.Lock()


def load(variant: str = "auto") -> Library | None:
    """The native library, or None for the torch reference.

    variant: "auto" takes JGHAND_BACKEND, else the best for this processor, and steps down to the next and to None with
    one line on stderr for each that fails; "torch" is None; a named variant that cannot be had is an InputError or
    RetryError.
    """
    if variant not in BACKENDS:
        raise InputError("backend", wanted=" | ".join(BACKENDS), came=variant)
    with _lock:
        if variant not in _loaded:
            _loaded[variant] = _load_automatic() if variant == "auto" else _load_named(variant)
        return _loaded[variant]


def _load_automatic() -> Library | None:
    wanted = os.environ.get("JGHAND_BACKEND", "").strip() or "auto"
    try:
        if wanted not in BACKENDS:
            raise InputError("JGHAND_BACKEND", wanted=" | ".join(BACKENDS), came=wanted)
        candidates = runnable_variants() if wanted == "auto" else [wanted]
        if not candidates:
            raise RetryError(f"no native kernel for {build.host_platform()} with this processor")
    except (JGHandError, OSError) as error:
        _say_next("torch", error)
        return None
    for variant, following in zip(candidates, [*candidates[1:], "torch"], strict=True):
        try:
            return _load_named(variant)
        except (JGHandError, OSError) as error:
            _say_next(following, error)
    return None


def _say_next(variant: str, error: Exception) -> None:
    """One line about what draws instead, and why."""
    instead = "torch reference" if variant == "torch" else f"kernel {variant}"
    print(f"jghand: drawing with the slower {instead}: {error}", file=sys.stderr)


def _load_named(variant: str) -> Library | None:
    if variant == "torch":
        return None
    if variant not in runnable_variants():
        raise InputError("native variant", wanted=f"one of {runnable_variants()} on this processor", came=variant)
    library = open_library(_current_library(variant), variant)
    selftest.check(library)
    return library
