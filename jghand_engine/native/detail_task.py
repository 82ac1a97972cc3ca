"""What the call for detail takes: mirrors of the structures in native/detail.cpp, and how its texels are written."""

from __future__ import annotations

import ctypes

import numpy as np

_I32, _F32, _P = ctypes.c_int32, ctypes.c_float, ctypes.c_void_p

# vectors of sixteen floats that the kernel keeps of a face, and numbers of where it is on the image
FACE_VECTORS, FACE_BOUNDS = 3, 5
# a texel is three channels of so many bits in 32; the middle one is the ratio 1
TEXEL_BITS, TEXEL_ZERO = 10, 512


class DetailHand(ctypes.Structure):
    """DetailHand of native/detail.cpp, field by field."""

    _fields_ = (
        *((name, _P) for name in ("surface", "vertex", "corner", "opposite", "corner_uv", "whole")),
        *((name, _P) for name in ("planes", "bounds", "box", "wide_box", "texels")),
        *((name, _I32) for name in ("size_log2", "groups")),
        *((name, _F32) for name in ("facing", "depth", "fade_from", "fade_to", "strength", "exponent", "cap")),
        *((name, _P) for name in ("learned", "normal", "nearest", "beside", "share", "bend", "slope", "gloss")),
        ("rise", _F32),
        ("around", _P),
        ("side_share", _P),
        ("side_blocks", _I32),
        ("turned", _P),
        ("pictures", _P),
    )


class DetailTask(ctypes.Structure):
    """DetailTask of native/detail.cpp, field by field."""

    _fields_ = (
        *((name, _P) for name in ("hands", "picture", "hit", "hit_near")),
        ("camera_from_position", ctypes.c_double * 12),
        *(
            (name, _F32)
            for name in ("fx", "fy", "cx", "cy", "z_near", "alpha_from", "alpha_to", "graze_max", "outline")
        ),
        ("layer", _P),
        *((name, _I32) for name in ("hand_count", "width", "height", "orthographic", "layers", "near_stride")),
    )


def packed_texels(steps: np.ndarray) -> np.ndarray:
    """(N,) uint32 of (N, 3) whole steps away from the ratio 1."""
    channel = (steps + np.int16(TEXEL_ZERO)).astype(np.uint32)
    return channel[:, 0] | channel[:, 1] << np.uint32(TEXEL_BITS) | channel[:, 2] << np.uint32(2 * TEXEL_BITS)
