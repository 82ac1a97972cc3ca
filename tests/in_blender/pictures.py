# SPDX-License-Identifier: GPL-3.0-or-later
"""What a step asks of a picture of the screen, (H, W, 3) uint8, top row first."""

import struct
import zlib
from pathlib import Path

import numpy as np


def read_ppm(content: bytes) -> np.ndarray:
    """(H, W, 3) uint8 of a binary PPM with 8 bits."""
    kind, width, height, most = content.split(maxsplit=4)[:4]
    if (kind, most) != (b"P6", b"255"):
        raise ValueError(f"a picture of the screen is no PPM of 8 bits: {content[:20]!r}")
    pixels = np.frombuffer(content, np.uint8)[-int(width) * int(height) * 3 :]
    return pixels.reshape(int(height), int(width), 3)


def write_png(path: Path, picture: np.ndarray) -> None:
    """Writes (H, W, 3) uint8 as it is."""
    height, width = picture.shape[:2]
    rows = np.zeros((height, 1 + 3 * width), np.uint8)
    rows[:, 1:] = picture.reshape(height, -1)
    chunks = (
        (b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)),
        (b"IDAT", zlib.compress(rows.tobytes(), 6)),
        (b"IEND", b""),
    )
    body = b"".join(
        struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data)) for name, data in chunks
    )
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + body)


def skin(picture: np.ndarray) -> np.ndarray:
    """(H, W) bool: pixels of the color of skin, which nothing of Blender's window has but its orange outlines."""
    red, green, blue = (picture[..., channel].astype(int) for channel in range(3))
    return (red > 60) & (red - blue > 15) & (red - green > 5) & (red - green < 90) & (green >= blue - 5) & (red < 250)


def changed(before: np.ndarray, after: np.ndarray, least: int = 8) -> np.ndarray:
    """(H, W) bool: pixels that differ by at least so much in one channel."""
    return np.abs(before.astype(int) - after.astype(int)).max(-1) >= least
