"""The functions of a native library as Python sees them: signatures, checked arrays, opening a file.

Which file is opened, and whether it is trusted, is the business of `library`.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError, RetryError

ABI = 16

_P, _I32 = ctypes.c_void_p, ctypes.c_int32

# name: (result, arguments) of every exported function, declared once. Pointers come from `address`.
SIGNATURES: dict[str, tuple[object, tuple[object, ...]]] = {
    "jg_abi": (_I32, ()),
    "jg_stamp": (ctypes.c_char_p, ()),
    "jg_variant": (ctypes.c_char_p, ()),
    "jg_skin_task_bytes": (_I32, ()),
    "jg_skin": (None, (_P, _P)),
    "jg_learned_task_bytes": (_I32, ()),
    "jg_scene_light_task_bytes": (_I32, ()),
    "jg_sweep_floats": (ctypes.c_int64, (_I32,)),
    "jg_lamp_depth_bytes": (_I32, ()),
    "jg_learned_pose": (None, (_P, _P)),
    "jg_learned_gloss": (None, (_P, _P)),
    "jg_shade_task_bytes": (_I32, ()),
    "jg_shade_gradient_bytes": (_I32, ()),
    "jg_shade": (None, (_P, _P)),
    "jg_shade_backward": (None, (_P, _P, _P)),
    "jg_detail_hand_bytes": (_I32, ()),
    "jg_detail_task_bytes": (_I32, ()),
    "jg_detail_surface": (None, (_P, _P)),
    "jg_detail": (None, (_P, _P)),
    "jg_ssim_task_bytes": (_I32, ()),
    "jg_ssim": (None, (_P, _P)),
    "jg_mean_task_bytes": (_I32, ()),
    "jg_mean_add": (None, (_P, _P)),
    "jg_mean_finish": (None, (_P, _P)),
    "jg_team_bytes": (_I32, ()),
    "jg_raster_job_bytes": (_I32, ()),
    "jg_raster_lists": (None, (_P,)),
    "jg_raster_forward": (None, (_P,)),
    "jg_raster_backward": (None, (_P,)),
    "jg_skeleton_bytes": (_I32, ()),
    "jg_bone_transforms": (_I32, (_P, _P, _P, _P, _P)),
    "jg_view": (None, (_I32, _P, _P, _P, _P, _P, _P, _I32, _P)),
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
