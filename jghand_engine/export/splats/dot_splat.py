"""Gaussians as a .splat file (EXPORT 9): no header, 32 bytes each.

0: 3 float32 position · 12: 3 float32 sigma, meters, not its logarithm · 24: 4 bytes sRGB color and opacity times 255 ·
28: 4 bytes quaternion w, x, y, z times 128, plus 128
"""

from __future__ import annotations

import numpy as np

from jghand_engine.export.pictures import to_bytes
from jghand_engine.export.splats.cloud import SplatCloud

ROW = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
BYTES_PER_GAUSSIAN = ROW.itemsize


def splat_bytes(cloud: SplatCloud) -> bytes:
    """The content of a file."""
    rows = np.zeros(len(cloud), ROW)
    rows["position"], rows["scale"] = cloud.positions_m, cloud.scales_m
    rows["rgba"][:, :3], rows["rgba"][:, 3] = to_bytes(cloud.rgb), to_bytes(cloud.opacity)
    # 1 would be 256: it becomes 255, and readers normalize
    rows["rotation"] = np.clip(np.round(cloud.rotations_wxyz * 128 + 128), 0, 255)
    return rows.tobytes()
