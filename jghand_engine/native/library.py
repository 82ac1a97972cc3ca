"""Loading the native library: which variant, is it up to date, does it compute what it should.

Nothing here fails because there is no native library: then `load` returns None after one line that says why, and the
torch reference draws the same picture, slower. Only a variant that was asked for by name is an error when missing.
"""

from __future__ import annotations

import ctypes
import os
import sys
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.native import build

ABI = 2
VARIANTS = ("v4", "v3", "neon")
BACKENDS = ("auto", "torch", *VARIANTS)

_P, _I32, _I64, _F32 = ctypes.c_void_p, ctypes.c_int32, ctypes.c_int64, ctypes.c_float

# name: (result, arguments) of every exported function, declared once. Pointers come from `address`.
SIGNATURES: dict[str, tuple[object, tuple[object, ...]]] = {
    "jg_abi": (_I32, ()),
    "jg_stamp": (ctypes.c_char_p, ()),
    "jg_variant": (ctypes.c_char_p, ()),
    "jg_skin_task_bytes": (_I32, ()),
    "jg_skin": (None, (_P, _P)),
    "jg_shade_task_bytes": (_I32, ()),
    "jg_shade_gradient_bytes": (_I32, ()),
    "jg_shade": (None, (_P, _P)),
    "jg_shade_backward": (None, (_P, _P, _P)),
    "jg_team_bytes": (_I32, ()),
    "jg_raster_job_bytes": (_I32, ()),
    "jg_raster_forward": (None, (_P,)),
    "jg_raster_backward": (None, (_P,)),
    "jg_skeleton_bytes": (_I32, ()),
    "jg_bone_transforms": (_I32, (_P, _P, _P, _P)),
}


@dataclass(frozen=True)
class Library:
    """A loaded library. `call` holds the exported functions as attributes with their signatures set."""

    variant: str
    path: Path
    call: ctypes.CDLL


def address(
    array: np.ndarray, dtype: type, name: str, shape: tuple[int, ...] | None = None, *, writable: bool = False
) -> int:
    """The address of an array's data for a ctypes call. writable: the call writes into it.

    A wrong dtype, shape, order, alignment or a read-only output is an InputError that names the array: the kernel
    cannot see them.
    """
    wanted = np.dtype(dtype)
    if not isinstance(array, np.ndarray) or array.dtype != wanted:
        came = str(array.dtype) if isinstance(array, np.ndarray) else type(array).__name__
        raise InputError(f"array {name}", wanted=f"dtype {wanted}", came=came)
    if shape is not None and array.shape != shape:
        raise InputError(f"array {name}", wanted=f"shape {shape}", came=str(array.shape))
    if not (array.flags.c_contiguous and array.flags.aligned):
        raise InputError(f"array {name}", wanted="contiguous, aligned memory", came="a strided or unaligned view")
    if writable and not array.flags.writeable:
        raise InputError(f"array {name}", wanted="memory that may be written", came="a read-only array")
    return array.ctypes.data


def aligned_zeros(shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
    """Zeros that start on a cache line: vector loads that straddle two lines are slower."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    raw = np.zeros(size + 64, np.uint8)
    start = -raw.ctypes.data % 64
    return raw[start : start + size].view(dtype).reshape(shape)


# bytes of `Team` in native/team.h: 16 steps of two counters, each alone on its cache line
_TEAM_BYTES = 16 * 2 * 64


def new_team() -> np.ndarray:
    """The counters by which threads share one call. Set them to zero (`team.fill(0)`) before every call."""
    return aligned_zeros((_TEAM_BYTES,), np.uint8)


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
    """The path of an up-to-date library; builds it when it is missing or stale and a compiler is there."""
    target = build.TARGETS.get(f"{build.host_platform()}_{variant}")
    if target is None:
        raise InputError("native variant", wanted=f"one for {build.host_platform()}", came=variant)
    path = build.LIBRARY_FOLDER / target.file_name
    if build.is_current(target):
        return path
    state = "was built from other sources" if path.exists() else "is missing"
    try:
        return build.build(target)
    except JGHandError as error:
        raise RetryError(f"native library {path.name} {state} and could not be built", remedy=str(error)) from error


# ---- loading --------------------------------------------------------------------------------------------------------

_loaded: dict[str, Library | None] = {}
_lock = threading.Lock()


def load(variant: str = "auto") -> Library | None:
    """The native library, or None for the torch reference.

    variant: "auto" takes JGHAND_BACKEND, else the best for this processor, and falls back to None with one line on
    stderr; "torch" is None; a named variant that cannot be had is an InputError or RetryError.
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
        chosen = best_variant() if wanted == "auto" else wanted
        if chosen is None:
            raise RetryError(f"no native kernel for {build.host_platform()} with this processor")
        return _load_named(chosen)
    except (JGHandError, OSError) as error:
        print(f"jghand: drawing with the slower torch reference: {error}", file=sys.stderr)
        return None


def _load_named(variant: str) -> Library | None:
    if variant == "torch":
        return None
    if variant not in runnable_variants():
        raise InputError("native variant", wanted=f"one of {runnable_variants()} on this processor", came=variant)
    library = open_library(_current_library(variant), variant)
    # imported here: the self-test draws, and drawing needs this module
    from jghand_engine.native import selftest

    selftest.check(library)
    return library


def open_library(path: Path, variant: str) -> Library:
    """Loads a library file, checks its ABI number and declares its functions. RetryError when it does not fit."""
    try:
        call = ctypes.CDLL(str(path))
        for name, (result, arguments) in SIGNATURES.items():
            function = getattr(call, name)
            function.restype, function.argtypes = result, arguments
    except (OSError, AttributeError) as error:
        raise RetryError(f"native library {path.name} cannot be loaded: {error}") from error
    if (abi := call.jg_abi()) != ABI:
        raise RetryError(f"native library {path.name}", wanted=f"ABI {ABI}", came=f"ABI {abi}", remedy="Build it anew.")
    return Library(variant, path, call)
