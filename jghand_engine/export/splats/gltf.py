"""Gaussians as a binary glTF file with the extension KHR_gaussian_splatting (EXPORT 9).

One primitive of mode POINTS. Sizes are linear (the drafts before February 2026 had logarithms), quaternions x, y, z, w,
colors display-referred sRGB, as the extension's color space says; COLOR_0, for viewers that know points only, is
light.
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np

from jghand_engine import __version__
from jghand_engine.color import srgb_to_linear, to_bytes
from jghand_engine.export.splats.cloud import SH_C0, SplatCloud

EXTENSION = "KHR_gaussian_splatting"
# of a binary glTF file, and of its two parts
MAGIC, VERSION, JSON_CHUNK, BINARY_CHUNK = b"glTF", 2, 0x4E4F534A, 0x004E4942
_POINTS, _FLOAT, _UNSIGNED_BYTE, _ARRAY_BUFFER = 0, 5126, 5121, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def glb_bytes(cloud: SplatCloud) -> bytes:
    """The content of a file. The cloud's axes must be rub: glTF says that y is up."""
    arrays = _arrays(cloud)
    binary = b"".join(array.tobytes() for array in arrays.values())
    text = json.dumps(_description(arrays, cloud.light), separators=(",", ":"), allow_nan=False).encode("ascii")
    text += b" " * (-len(text) % 4)
    total = 12 + 8 + len(text) + 8 + len(binary)
    return b"".join((
        struct.pack("<4sII", MAGIC, VERSION, total),
        struct.pack("<II", len(text), JSON_CHUNK), text,
        struct.pack("<II", len(binary), BINARY_CHUNK), binary,
    ))  # fmt: skip


def _arrays(cloud: SplatCloud) -> dict[str, np.ndarray]:
    """Name of the attribute -> its array; each row is a multiple of four bytes long, as glTF wants it."""
    fallback = to_bytes(np.column_stack([srgb_to_linear(cloud.rgb), cloud.opacity]))
    floats = {
        "POSITION": cloud.positions_m,
        f"{EXTENSION}:ROTATION": cloud.rotations_wxyz[:, [1, 2, 3, 0]],
        f"{EXTENSION}:SCALE": cloud.scales_m,
        f"{EXTENSION}:OPACITY": cloud.opacity[:, None],
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": (cloud.rgb - 0.5) / SH_C0,
    }
    return {"COLOR_0": fallback, **{name: np.ascontiguousarray(array, "<f4") for name, array in floats.items()}}


def _description(arrays: dict[str, np.ndarray], light: str) -> dict[str, Any]:
    views, accessors, start = [], [], 0
    for index, (name, array) in enumerate(arrays.items()):
        count, width = array.shape
        views.append({"buffer": 0, "byteOffset": start, "byteLength": array.nbytes, "target": _ARRAY_BUFFER})
        bytewise = array.dtype == np.uint8
        accessor = {
            "bufferView": index, "componentType": _UNSIGNED_BYTE if bytewise else _FLOAT, "count": count,
            "type": _TYPES[width], **({"normalized": True} if bytewise else {}),
        }  # fmt: skip
        if name == "POSITION":
            accessor |= {"min": array.min(0).tolist(), "max": array.max(0).tolist()}
        accessors.append(accessor)
        start += array.nbytes
    splats = {
        "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
        "projection": "perspective", "sortingMethod": "cameraDistance",
    }  # fmt: skip
    primitive = {
        "mode": _POINTS,
        "attributes": {name: index for index, name in enumerate(arrays)},
        "extensions": {EXTENSION: splats},
    }
    return {
        "asset": {"version": "2.0", "generator": f"JGHand {__version__}", "extras": {"light": light}},
        "extensionsUsed": [EXTENSION],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "hand", "mesh": 0}],
        "meshes": [{"name": "hand", "primitives": [primitive]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": start}],
    }
