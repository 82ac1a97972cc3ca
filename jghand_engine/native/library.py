"""Loading the native library: which variant, is it up to date, does it compute what it should.

A library comes with the package. Where none works, such as on a processor that is too old, one sentence says so.
"""

from __future__ import annotations

import ctypes
import itertools
import os
import sys
import threading
from pathlib import Path

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.native import build, selftest
from jghand_engine.native.binding import Library, open_library

VARIANTS = ("v4", "v3", "neon")
# the last step of a picture on a graphics card (jghand_engine/gpu), all others by the best variant
GPU = "gpu"
BACKENDS = ("auto", *VARIANTS, GPU)

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

_loaded: dict[str, Library] = {}
_lock = threading.Lock()


def load(variant: str = "auto") -> Library:
    """The native library.

    variant: "auto" takes JGHAND_BACKEND, else the best for this processor, and steps down to the next with one line on
    stderr for each that fails; "gpu" takes the same, for what is done beside a graphics card. InputError for an
    unknown name, RetryError where there is no library that works here.
    """
    if variant not in BACKENDS:
        raise InputError("backend", wanted=" | ".join(BACKENDS), came=variant)
    with _lock:
        if variant not in _loaded:
            _loaded[variant] = _load_automatic() if variant in ("auto", GPU) else _load_named(variant)
        return _loaded[variant]


def _load_automatic() -> Library:
    wanted = os.environ.get("JGHAND_BACKEND", "").strip() or "auto"
    if wanted not in BACKENDS:
        raise InputError("JGHAND_BACKEND", wanted=" | ".join(BACKENDS), came=wanted)
    if wanted not in ("auto", GPU):
        return _load_named(wanted)
    variants = runnable_variants()
    if not variants:
        raise RetryError(f"There are no kernels for {build.host_platform()} with this processor")
    for variant, following in itertools.pairwise(variants):
        try:
            return _load_named(variant)
        except (JGHandError, OSError) as error:
            print(f"jghand: drawing with the slower kernel {following}: {error}", file=sys.stderr)
    return _load_named(variants[-1])


def _load_named(variant: str) -> Library:
    if variant not in runnable_variants():
        raise InputError("native variant", wanted=f"one of {runnable_variants()} on this processor", came=variant)
    library = open_library(_current_library(variant), variant)
    selftest.check(library)
    return library
