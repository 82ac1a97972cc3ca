"""What trained skin in the light of a scene takes: mirrors of native/scene_light.h, field by field."""

from __future__ import annotations

import ctypes
from enum import IntEnum

_I32, _F32, _P = ctypes.c_int32, ctypes.c_float, ctypes.c_void_p


class LampKind(IntEnum):
    """Kinds of lamps, as Blender has them."""

    SUN = 0
    POINT = 1
    SPOT = 2
    AREA = 3


# numbers of one lamp, in their order: LampNumber of native/scene_light.h, which says what they are
LAMP_NUMBERS = (
    *("place_x", "place_y", "place_z", "axis_x", "axis_y", "axis_z", "red", "green", "blue", "softening", "radius2"),
    *("sun_sine", "cone", "cone_scale", "spread", "spread_gain", "kind", "slot", "on_matt", "on_gloss"),
    "shade",
)
# of a patch of anchors, see there
THROWN = 10
NUMBER = {name: place for place, name in enumerate(LAMP_NUMBERS)}


# directions along which thrown light is swept, by so many items of work, and texels of its picture (native/bounce.cpp)
SWEPT, SWEEPS, GRID = 64, 16, 96
# places of the picture of a lamp that a point is compared with
LAMP_TAPS = 16
# lamps whose light can be drawn apart, and numbers that are kept of it (native/scene_light.h)
LAYERS_MAX, APART = 8, 5


class Above(ctypes.Structure):
    """Above of native/lamp_depth.h."""

    _fields_ = (("corner", _P), ("share", _P))


class LampDepth(ctypes.Structure):
    """LampDepth of native/lamp_depth.h."""

    _fields_ = (
        *((name, _P) for name in ("near", "disc", "vertex")),
        ("skin", Above),
        ("anchors", Above),
        ("axes", _F32 * 9),
        ("place", _F32 * 3),
        *((name, _F32) for name in ("focal", "part", "scale", "radius2")),
        *((name, _I32) for name in ("size", "orthographic", "rows", "layer")),
    )


class SceneLightTask(ctypes.Structure):
    """SceneLightTask of native/scene_light.h."""

    _fields_ = (
        *((name, _P) for name in ("material", "own", "partly", "hides_start", "hides", "lamp", "casting")),
        *((name, _P) for name in ("irradiance", "left", "baked", "depth", "lobe")),
        *((name, _P) for name in ("posed", "visible", "skin_seen", "apart", "layer", "at_pixels")),
        *((name, _P) for name in ("thrown", "beside", "bounced")),
        *((name, _P) for name in ("area", "swept", "once", "sent", "caught", "sweeping")),
        *((name, _P) for name in ("reflecting", "sky", "reached")),
        *((name, _F32 * 3) for name in ("softness", "bounce", "least")),
        *((name, _F32) for name in ("shade_gain", "flesh_softness", "wide_softness", "sine2_min", "texel_m", "shade")),
        ("layer_stride", _I32),
        *((name, _I32) for name in ("lamps", "slots", "lobes", "layers", "keeps_pose", "keeps_visible")),
    )
