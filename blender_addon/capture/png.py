# SPDX-License-Identifier: GPL-3.0-or-later
"""PNGs with nothing but their picture and a stamp, so that the same plan gives the same bytes."""

import struct
import zlib

SIGNATURE = b"\x89PNG\r\n\x1a\n"
# the word under which the stamp stands in the file; the engine looks for it
STAMP_KEY = "jghand-stamp"
# what decoders need; Blender adds date, host and render time as text
_KEPT = (b"IHDR", b"PLTE", b"tRNS", b"sRGB", b"IDAT", b"IEND")


def stamped(data: bytes, stamp: str) -> bytes:
    """The PNG `data` without its texts, with the Latin-1 text `stamp`. ValueError when it is not a whole PNG."""
    if not data.startswith(SIGNATURE):
        raise ValueError("not a PNG")
    result, place = [SIGNATURE], len(SIGNATURE)
    while place < len(data):
        (length,) = struct.unpack(">I", data[place : place + 4])
        kind = data[place + 4 : place + 8]
        end = place + 12 + length
        if end > len(data):
            raise ValueError("a PNG that breaks off")
        if kind in _KEPT:
            result.append(data[place:end])
        if kind == b"IHDR":
            result.append(_chunk(b"tEXt", _text(stamp)))
        place = end
        if kind == b"IEND":
            return b"".join(result)
    raise ValueError("a PNG without an end")


def encoded(pixels, stamp: str) -> bytes:
    """(H, W, 4) uint8 as such a PNG."""
    height, width = pixels.shape[:2]
    rows = b"".join(b"\0" + row.tobytes() for row in pixels)
    kinds = (b"IHDR", b"tEXt", b"sRGB", b"IDAT", b"IEND")
    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return SIGNATURE + b"".join(map(_chunk, kinds, (head, _text(stamp), b"\0", zlib.compress(rows), b"")))


def _text(stamp: str) -> bytes:
    return STAMP_KEY.encode() + b"\0" + stamp.encode("latin-1")


def _chunk(kind: bytes, content: bytes) -> bytes:
    body = kind + content
    return struct.pack(">I", len(content)) + body + struct.pack(">I", zlib.crc32(body))
