"""Gaussians as an SPZ file, version 3 (EXPORT 9): whole numbers of few bits, packed by gzip.

    header: magic, version, count (3 uint32), degree of the harmonics, fractional bits, flags, 0 (4 bytes)
    positions 3 x 24 bits, fixed point · opacity 8 bits · color 3 x 8 bits, of the harmonics times 0.15 ·
    ln(sigma) 3 x 8 bits, steps of 1/16 from -10 on · quaternion 32 bits: which component is largest, and the others

Written here and not by a package because a hand needs more than the usual 12 fractional bits, whose steps are 0.24 mm,
and the packages that give more bring a compiler along.
"""

from __future__ import annotations

import gzip
import math
import struct

import numpy as np

from jghand_engine.color import to_bytes
from jghand_engine.export.splats.cloud import SH_C0, SplatCloud

MAGIC, VERSION = 0x5053474E, 3
POSITION_BITS, QUATERNION_BITS, STEPS_PER_LN = 24, 9, 16
# bits of a position behind the point: steps of 0.004 mm, and 32 m on each side of the origin
FRACTIONAL_BITS = 18
# what the harmonics of band 0 are multiplied by before they are cut to 0..1, and where ln(sigma) begins
COLOR_SCALE, LN_SIGMA_MIN = 0.15, -10.0
# 0..9, as the format's own library has it
GZIP_LEVEL = 6


def spz_bytes(cloud: SplatCloud) -> bytes:
    """The content of a file. SPZ documents axes rub as its own; the cloud's are written as they are."""
    bits = fractional_bits(cloud.positions_m)
    fixed_point = np.round(cloud.positions_m.astype(np.float64) * 2**bits).astype("<i4")
    harmonics = (cloud.rgb - 0.5) / SH_C0
    parts = (
        struct.pack("<IIIBBBB", MAGIC, VERSION, len(cloud), 0, bits, 0, 0),
        fixed_point.view(np.uint8).reshape(-1, 4)[:, :3].tobytes(),
        to_bytes(cloud.opacity).tobytes(),
        to_bytes(harmonics * COLOR_SCALE + 0.5).tobytes(),
        _steps((np.log(cloud.scales_m) - LN_SIGMA_MIN) * STEPS_PER_LN).tobytes(),
        _smallest_three(cloud.rotations_wxyz[:, [1, 2, 3, 0]]).tobytes(),
    )
    # without a time, so that equal hands give equal files
    return gzip.compress(b"".join(parts), GZIP_LEVEL, mtime=0)


def fractional_bits(positions_m: np.ndarray) -> int:
    """As many as the farthest of (N, 3) centers leaves, at most FRACTIONAL_BITS."""
    farthest_m = float(np.abs(positions_m).max(initial=0))
    # one step of room for rounding up
    whole_bits = 0 if farthest_m == 0 else math.ceil(math.log2(farthest_m + 2**-FRACTIONAL_BITS))
    return max(0, min(FRACTIONAL_BITS, POSITION_BITS - 1 - whole_bits))


def _steps(values: np.ndarray) -> np.ndarray:
    return np.clip(np.round(values), 0, 255).astype(np.uint8)


def _smallest_three(rotations_xyzw: np.ndarray) -> np.ndarray:
    """(N,) uint32 from unit quaternions (N, 4): index of the largest component, then sign and size of the others."""
    largest = np.abs(rotations_xyzw).argmax(1)
    rows = np.arange(len(largest))
    # the same rotation with its largest component positive
    upright = rotations_xyzw * np.where(rotations_xyzw[rows, largest] < 0, -1.0, 1.0)[:, None]
    others = upright[np.arange(4) != largest[:, None]].reshape(-1, 3)
    steps = 2**QUATERNION_BITS - 1
    sizes = np.minimum(np.round(np.abs(others) * (math.sqrt(2) * steps)), steps).astype(np.uint32)
    fields = sizes | ((others < 0).astype(np.uint32) << QUATERNION_BITS)
    packed = largest.astype(np.uint32)
    for column in fields.T:
        packed = (packed << (QUATERNION_BITS + 1)) | column
    return packed.astype("<u4")
