"""Gaussians of SPZ files 2 and 3 of anybody. Only degree 0 of the harmonics is kept."""

from __future__ import annotations

import itertools
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import IO

import numpy as np

from jghand_engine.export.splats import spz
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.rows import SplatRows, damaged
from jghand_engine.limits import SH_C0, SPZ_CHUNK_BYTES, SPZ_COLOR_SCALE, SPZ_LN_SIGMA_MIN, SPZ_RATIO_MAX

_HEADER = struct.Struct("<IIIBBBB")
_SH_BANDS = {0: 0, 1: 3, 2: 8, 3: 15}


def spz_rows(path: Path, stream: IO[bytes]) -> SplatRows:
    """The Gaussians of an open file, unpacked. InputError, which names it, for one that is damaged or lies."""
    if stream.read(4) == struct.pack("<I", spz.MAGIC):
        raise damaged(path, "SPZ 2 or 3", "version 4, whose parts are packed by zstd")
    stream.seek(0)
    try:
        magic, version, count, degree, bits, *_ = _HEADER.unpack(next(_inflated(stream, _HEADER.size), b""))
    except (zlib.error, struct.error) as error:
        raise damaged(path, "an SPZ file, packed by gzip", error) from error
    if magic != spz.MAGIC or version not in (2, 3) or degree not in _SH_BANDS or not bits <= spz.POSITION_BITS:
        raise damaged(path, "a header of SPZ 2 or 3", f"version {version}, degree {degree}, {bits} bits")
    widths = (9, 1, 3, 3, 4 if version == 3 else 3)
    kept = _HEADER.size + count * sum(widths)
    if kept > SPZ_RATIO_MAX * path.stat().st_size:
        raise damaged(path, f"at most {SPZ_RATIO_MAX} times its size unpacked", f"{count} Gaussians")
    # counted before memory is taken for it: a file that is cut off, or longer than it says, costs nothing. What follows
    # the kept part are the harmonics of higher degrees
    wanted = kept + count * 3 * _SH_BANDS[degree]
    if (there := _length(path, stream, wanted)) != wanted:
        raise damaged(path, f"{wanted} bytes unpacked, as its header says", "more" if there > wanted else there)
    content = _beginning(stream, kept)
    ends = list(itertools.accumulate((width * count for width in widths), initial=_HEADER.size))
    tables = [content[ends[k] : ends[k + 1]].reshape(count, width) for k, width in enumerate(widths)]

    def part(rows: slice) -> SplatCloud:
        positions, alphas, colors, sizes, turns = (table[rows] for table in tables)
        whole = np.zeros((len(positions), 3, 4), np.uint8)
        whole[..., 1:] = positions.reshape(-1, 3, 3)
        harmonics = (colors / np.float32(255) - np.float32(0.5)) / np.float32(SPZ_COLOR_SCALE)
        return SplatCloud(
            (whole.view("<i4")[..., 0] >> 8) / np.float32(2**bits),
            np.exp(sizes / np.float32(spz.STEPS_PER_LN) + np.float32(SPZ_LN_SIGMA_MIN)),
            (spz.unpacked_smallest_three if version == 3 else _first_three)(np.ascontiguousarray(turns)),
            alphas[:, 0] / np.float32(255),
            harmonics * np.float32(SH_C0) + np.float32(0.5),
            "rub",
        )

    return SplatRows(path, count, "rub", part)


def _beginning(stream: IO[bytes], length: int) -> np.ndarray:
    """(length,) uint8 of the unpacked content."""
    stream.seek(0)
    content, at = np.empty(length, np.uint8), 0
    for piece in _inflated(stream):
        more = piece[: length - at]
        content[at : at + len(more)] = np.frombuffer(more, np.uint8)
        at += len(more)
    return content


def _inflated(stream: IO[bytes], limit: int = 0) -> Iterator[bytes]:
    """The unpacked content in pieces, or `limit` bytes of it. zlib.error for what is damaged or cut off."""
    unpacker = zlib.decompressobj(16 + zlib.MAX_WBITS)
    while not unpacker.eof:
        packed = unpacker.unconsumed_tail or stream.read(SPZ_CHUNK_BYTES)
        piece = unpacker.decompress(packed, limit or SPZ_CHUNK_BYTES)
        if piece:
            yield piece
            if limit:
                return
        elif not packed:
            raise zlib.error("it is cut off")
    if unpacker.unused_data or stream.read(1):
        raise zlib.error("something follows its end")


def _length(path: Path, stream: IO[bytes], most: int) -> int:
    """How many bytes the content has unpacked; counting ends beyond `most`."""
    stream.seek(0)
    length = 0
    try:
        for piece in _inflated(stream):
            length += len(piece)
            if length > most:
                break
    except zlib.error as error:
        raise damaged(path, "an SPZ file, packed by gzip", error) from error
    return length


def _first_three(turns: np.ndarray) -> np.ndarray:
    """(N, 4) w, x, y, z from the three bytes of SPZ 2."""
    xyz = turns / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(1, keepdims=True)))
    return np.concatenate([w, xyz], 1)
