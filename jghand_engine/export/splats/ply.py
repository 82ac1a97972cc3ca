"""Gaussians in the two oldest layouts that splat viewers share (EXPORT 9), as they are and as SOG.

PLY, binary_little_endian, `element vertex N`, all `property float`; no field for axes, units, light: a comment has them

    x y z · nx ny nz (0) · f_dc_0..2 = (rgb - 0.5) / SH_C0, display-referred sRGB · opacity as logit ·
    scale_0..2 as ln(sigma), meters · rot_0..3 = w, x, y, z

.splat, no header, 32 bytes each:

    0: 3 float32 position · 12: 3 float32 sigma, meters, not its logarithm · 24: 4 bytes sRGB color and opacity times
    255 · 28: 4 bytes quaternion w, x, y, z times 128, plus 128

SOG: tables in WebP pictures, made of the PLY by the optional package gaussforge (extra `formats`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from jghand_engine.color import to_bytes
from jghand_engine.errors import InputError, package
from jghand_engine.export.splats.cloud import SH_C0, SplatCloud

PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
# opacity is written as a logit, which 0 and 1 have none of; the step of 8 bits is 4000 times larger
OPACITY_MARGIN = 1e-6
SPLAT_ROW = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])


def ply_bytes(cloud: SplatCloud) -> bytes:
    table = np.zeros((len(cloud), len(PROPERTIES)), "<f4")
    opacity = np.clip(cloud.opacity.astype(np.float64), OPACITY_MARGIN, 1 - OPACITY_MARGIN)
    table[:, 0:3] = cloud.positions_m
    table[:, 6:9] = (cloud.rgb - 0.5) / SH_C0
    table[:, 9] = np.log(opacity / (1 - opacity))
    table[:, 10:13] = np.log(cloud.scales_m)
    table[:, 13:17] = cloud.rotations_wxyz
    lines = (
        "ply",
        "format binary_little_endian 1.0",
        f"comment JGHand axes={cloud.axes} units=meters color=srgb" + (f" light={cloud.light}" if cloud.light else ""),
        f"element vertex {len(cloud)}",
        *(f"property float {name}" for name in PROPERTIES),
        "end_header\n",
    )
    return "\n".join(lines).encode("ascii") + table.tobytes()


def splat_bytes(cloud: SplatCloud) -> bytes:
    rows = np.zeros(len(cloud), SPLAT_ROW)
    rows["position"], rows["scale"] = cloud.positions_m, cloud.scales_m
    rows["rgba"][:, :3], rows["rgba"][:, 3] = to_bytes(cloud.rgb), to_bytes(cloud.opacity)
    # 1 would be 256: it becomes 255, and readers normalize
    rows["rotation"] = np.clip(np.round(cloud.rotations_wxyz * 128 + 128), 0, 255)
    return rows.tobytes()


def sog_bytes(cloud: SplatCloud) -> bytes:
    """The Gaussians come in another order. InputError where the package is missing."""
    answer = sog_converter().convert(ply_bytes(cloud), "ply", "sog")
    if "error" in answer:
        raise InputError("SOG file", wanted="Gaussians that gaussforge can write", came=str(answer["error"])[:200])
    return bytes(answer["data"])


def sog_converter() -> Any:
    """gaussforge's converter. InputError says how to get it."""
    return package("gaussforge", "SOG files", "formats").GaussForge()
