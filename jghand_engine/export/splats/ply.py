"""Gaussians as a PLY file, in the layout that splat viewers share (EXPORT 9).

    binary_little_endian, `element vertex N`, all `property float`:
    x y z · nx ny nz (0) · f_dc_0..2 = (rgb - 0.5) / SH_C0, display-referred sRGB · opacity as logit ·
    scale_0..2 as ln(sigma), meters · rot_0..3 = w, x, y, z

The format has no field for axes or units; a comment says them.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.export.splats.cloud import SH_C0, SplatCloud

PROPERTIES = (
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
)
# opacity is written as a logit, which 0 and 1 have none of; the step of 8 bits is 4000 times larger
OPACITY_MARGIN = 1e-6
BYTES_PER_GAUSSIAN = 4 * len(PROPERTIES)


def ply_bytes(cloud: SplatCloud) -> bytes:
    """The content of a file."""
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
        f"comment JGHand axes={cloud.axes} units=meters color=srgb",
        f"element vertex {len(cloud)}",
        *(f"property float {name}" for name in PROPERTIES),
        "end_header\n",
    )
    return "\n".join(lines).encode("ascii") + table.tobytes()
