"""A .usdz: a zip of stored files, each of which begins at a multiple of 64 bytes, so that readers map it into memory.

Written here and not by USD, which takes memory for all that it packs.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

from jghand_engine.errors import InputError
from jghand_engine.limits import USDZ_BYTES_MAX, USDZ_CHUNK_BYTES

ALIGNMENT = 64
# signature, version that unpacks it, flags, stored, time and date (1980-01-01), checksum, two sizes, lengths
_LOCAL = struct.Struct("<IHHHHHIIIHH")
_CENTRAL = struct.Struct("<IHHHHHHIIIHHHHHII")
_END = struct.Struct("<IHHHHIIH")
_EXTRA = struct.Struct("<HH")
_VERSION, _DATE, _PADDING = 10, 0x21, 0x1986


def write_zip(target: Path, files: Sequence[Path]) -> None:
    """Packs files under their names, the one that is opened first. InputError where a zip cannot hold them."""
    check_zip_size(sum(path.stat().st_size for path in files), target.name)
    directory = b""
    with target.open("wb") as out:
        for path in files:
            name, offset = path.name.encode(), out.tell()
            padding = _padding(offset + _LOCAL.size + len(name))
            out.write(bytes(_LOCAL.size) + name + padding)
            checksum, size = 0, 0
            with path.open("rb") as stream:
                while chunk := stream.read(USDZ_CHUNK_BYTES):
                    checksum, size = zlib.crc32(chunk, checksum), size + len(chunk)
                    out.write(chunk)
            about = _VERSION, 0, 0, 0, _DATE, checksum, size, size, len(name)
            end = out.tell()
            out.seek(offset)
            out.write(_LOCAL.pack(0x04034B50, *about, len(padding)))
            out.seek(end)
            directory += _CENTRAL.pack(0x02014B50, _VERSION, *about, 0, 0, 0, 0, 0, offset) + name
        out.write(directory + _END.pack(0x06054B50, 0, 0, len(files), len(files), len(directory), out.tell(), 0))


def check_zip_size(size: int, thing: str) -> None:
    """InputError for files of so many bytes in all: the places in a zip are numbers of 32 bits."""
    if size > USDZ_BYTES_MAX:
        raise InputError(
            f"package usdz of {thing}",
            wanted=f"at most {USDZ_BYTES_MAX / 1e9:.2f} GB, which is what a .usdz can hold",
            came=f"{size / 1e9:.2f} GB",
            remedy="Export layers, which are cut into files, or fewer frames.",
        )


def _padding(offset: int) -> bytes:
    """An extra field after which a multiple of ALIGNMENT comes; it has four bytes at least, or is not there."""
    missing = -offset % ALIGNMENT
    if not missing:
        return b""
    missing += ALIGNMENT if missing < _EXTRA.size else 0
    return _EXTRA.pack(_PADDING, missing - _EXTRA.size) + bytes(missing - _EXTRA.size)
