"""What the calls for trained skin take: mirrors of the structures in native/learned.h, field by field."""

from __future__ import annotations

import ctypes
from enum import IntEnum

from jghand_engine.native.tasks import SkinTask

_I32, _F32, _P = ctypes.c_int32, ctypes.c_float, ctypes.c_void_p

# units of the network's second layer that the kernel computes together, and its widest layers (native/learned.h)
NETWORK_TILE = 8
HIDDEN_MAX = 256


class CorrectiveKind(IntEnum):
    """Correctives of native/learned.h."""

    NONE = 0
    GIVEN = 1
    LINEAR = 2
    NETWORK = 3


class CastTask(ctypes.Structure):
    """CastTask of native/learned.h."""

    _fields_ = (
        *((name, _P) for name in ("rest", "block_start", "bone", "weight", "foreign", "lamp", "capsule")),
        *((name, _P) for name in ("capsule_lamp", "other", "fallen")),
        ("bounced", _F32 * 3),
        *((name, _F32) for name in ("softness", "lamp_width", "width_min", "distance2_min", "to_display")),
        *((name, _I32) for name in ("blocks", "groups", "capsules")),
    )


class LearnedTask(ctypes.Structure):
    """LearnedTask of native/learned.h."""

    _fields_ = (
        ("skin", SkinTask),
        ("cast", CastTask),
        ("scene", _P),
        *((name, _P) for name in ("look", "given", "direction", "constant", "numbers", "places", "features")),
        *((name, _P) for name in ("middle", "middle_bias", "out", "nearest", "share", "irradiance", "lobe")),
        *((name, _P) for name in ("matt", "rgb", "front", "hidden_from")),
        ("out_bias", _F32 * 6),
        ("reach", _F32 * 2),
        ("eye", _F32 * 3),
        *((name, _F32) for name in ("rim", "volume_min", "exponent_max", "length2_min")),
        *((name, _I32) for name in ("correctives", "world_offsets", "basis", "hidden", "lobes")),
        ("from_behind", _F32),
    )
