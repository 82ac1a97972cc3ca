"""Splat files of anybody, read without trust: PLY, .splat, GLB with KHR_gaussian_splatting, SPZ 2 and 3.

What a file claims about itself is compared with the bytes that are there before memory is taken for it. Only degree 0
of the harmonics is read. What can be read and is yet suspicious is told in sentences.
"""

from __future__ import annotations

import mmap
import re
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.exporters import dot_splat, spz
from jghand_engine.exporters.gltf_reading import glb_attributes
from jghand_engine.exporters.gltf_splats import EXTENSION
from jghand_engine.exporters.splat_cloud import SplatCloud
from jghand_engine.limits import (
    PLY_HEADER_BYTES_MAX,
    SH_C0,
    SPLAT_SIGMA_SANE_M,
    SPZ_CHUNK_BYTES,
    SPZ_COLOUR_SCALE,
    SPZ_LN_SIGMA_MIN,
    SPZ_RATIO_MAX,
)

_PLY_TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1",
              "char": "i1", "int8": "i1", "ushort": "<u2", "uint16": "<u2", "short": "<i2", "int16": "<i2",
              "uint": "<u4", "uint32": "<u4", "int": "<i4", "int32": "<i4"}  # fmt: skip
_SH_BANDS = {0: 0, 1: 3, 2: 8, 3: 15}
_REMEDY = "Write the file again with the program that it came from."


@dataclass(frozen=True)
class SplatFile:
    """format: suffix · cloud: its Gaussians; axes "" where the file does not say · findings: what is suspicious"""

    format: str
    cloud: SplatCloud
    findings: tuple[str, ...]


def read_splats(path: Path | str) -> SplatFile:
    """The Gaussians of a file. InputError, which names the file and what is wrong, for one that cannot be read: another
    kind, damaged, cut off, longer than it says, or with values that are no numbers."""
    place = Path(path)
    reader = _READERS.get(place.suffix.lower())
    if reader is None:
        raise InputError(f"{place}", wanted=f"a splat file: {', '.join(_READERS)}", came=place.suffix or "no suffix")
    try:
        with place.open("rb") as stream:
            if not place.stat().st_size:
                raise InputError(f"{place}", wanted="Gaussians", came="an empty file", remedy=_REMEDY)
            cloud = reader(place, stream)
    except OSError as error:
        raise InputError(f"cannot read {place}", came=error.strerror or str(error), remedy="Check the name.") from error
    for name in ("positions_m", "scales_m", "rotations_wxyz", "opacity", "rgb"):
        if not np.isfinite(getattr(cloud, name)).all():
            raise InputError(f"{place}, {name}", wanted="finite numbers", came="NaN or infinity", remedy=_REMEDY)
    return SplatFile(place.suffix.lower()[1:], cloud, tuple(_findings(cloud)))


def _findings(cloud: SplatCloud) -> Iterator[str]:
    if len(cloud) == 0:
        yield "there are no Gaussians"
        return
    if not (cloud.scales_m > 0).all():
        yield "sizes are not all above 0: they are probably logarithms where metres are wanted"
    elif float(np.median(cloud.scales_m)) > SPLAT_SIGMA_SANE_M:
        yield "half of the Gaussians are wider than a metre: sizes are probably linear where logarithms are wanted"
    if cloud.opacity.min() < 0 or cloud.opacity.max() > 1:
        yield "opacities are not all from 0 to 1: they are probably logits"
    elif cloud.opacity.min() >= 0.5 and cloud.opacity.max() <= 0.7311:
        yield "opacities are all from 0.5 to 0.73: they are probably no logits where logits are wanted"
    if (np.abs(np.linalg.norm(cloud.rotations_wxyz, axis=1)) < 1e-6).any():
        yield "some rotations have no length: readers drop those Gaussians or draw nothing"


def _damaged(path: Path, wanted: str, came: object) -> InputError:
    return InputError(f"{path}", wanted=wanted, came=str(came)[:200], remedy=_REMEDY)


# ---- PLY -------------------------------------------------------------------------------------------------------------


def _read_ply(path: Path, stream: IO[bytes]) -> SplatCloud:
    header, start = _ply_header(path, stream)
    row, count = _ply_rows(path, header)
    wanted, there = start + count * row.itemsize, path.stat().st_size
    if wanted != there:
        raise _damaged(path, f"{wanted} bytes, as its header says ({count} vertices)", there)
    names = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
             "rot_0", "rot_1", "rot_2", "rot_3")  # fmt: skip
    missing = [name for name in names if name not in (row.names or ())]
    if missing:
        raise _damaged(path, f"properties {', '.join(missing)} of a vertex, as splats have them", "none of that name")
    table = np.memmap(stream, row, "r", start, (count,)) if count else np.zeros(0, row)

    def columns(*wanted: str) -> np.ndarray:
        return np.stack([table[name].astype(np.float32) for name in wanted], -1)

    axes = re.search(r"^comment JGHand .*axes=(rdf|rub)\b", header, re.MULTILINE)
    with np.errstate(over="ignore"):
        return SplatCloud(
            columns("x", "y", "z"),
            np.exp(columns("scale_0", "scale_1", "scale_2")),
            columns("rot_0", "rot_1", "rot_2", "rot_3"),
            1 / (1 + np.exp(-columns("opacity")[:, 0])),
            columns("f_dc_0", "f_dc_1", "f_dc_2") * np.float32(SH_C0) + np.float32(0.5),
            axes[1] if axes else "",
        )


def _ply_header(path: Path, stream: IO[bytes]) -> tuple[str, int]:
    """The header's text, and where the data begin."""
    beginning = stream.read(PLY_HEADER_BYTES_MAX)
    found = re.match(rb"ply\r?\n(?s:.*?)\nend_header\r?\n", beginning)
    if not found:
        raise _damaged(path, f"a PLY header of at most {PLY_HEADER_BYTES_MAX} bytes", repr(beginning[:20]))
    try:
        return found[0].decode("ascii").replace("\r", ""), found.end()
    except UnicodeDecodeError:
        raise _damaged(path, "a PLY header in plain letters", "others") from None


def _ply_rows(path: Path, header: str) -> tuple[np.dtype, int]:
    """What one vertex holds, and how many there are."""
    lines = [line.split() for line in header.splitlines() if line.split()[:1] not in ([], ["comment"], ["obj_info"])]
    if lines[1:2] != [["format", "binary_little_endian", "1.0"]]:
        raise _damaged(path, "format binary_little_endian 1.0", " ".join(lines[1]) if len(lines) > 1 else "none")
    element, *properties = lines[2:-1] or [[]]
    if len(element) != 3 or element[:2] != ["element", "vertex"] or not re.fullmatch(r"\d{1,12}", element[2]):
        raise _damaged(path, "one element, vertex, with a count", " ".join(element))
    fields: dict[str, str] = {}
    for words in properties:
        if len(words) != 3 or words[0] != "property" or words[1] not in _PLY_TYPES or words[2] in fields:
            raise _damaged(path, "properties of one number each, each once, of one element", " ".join(words))
        fields[words[2]] = _PLY_TYPES[words[1]]
    if not fields:
        raise _damaged(path, "properties of a vertex", "none")
    return np.dtype(list(fields.items())), int(element[2])


# ---- .splat ----------------------------------------------------------------------------------------------------------


def _read_splat(path: Path, stream: IO[bytes]) -> SplatCloud:
    size = path.stat().st_size
    if size % dot_splat.BYTES_PER_GAUSSIAN:
        raise _damaged(path, f"a multiple of {dot_splat.BYTES_PER_GAUSSIAN} bytes", size)
    rows = np.memmap(stream, dot_splat.ROW, "r")
    rgba = rows["rgba"] / np.float32(255)
    turns = rows["rotation"].astype(np.float32)
    turns -= 128
    turns /= 128
    return SplatCloud(np.array(rows["position"]), np.array(rows["scale"]), turns, rgba[:, 3], rgba[:, :3], "")


# ---- GLB -------------------------------------------------------------------------------------------------------------


def _read_glb(path: Path, stream: IO[bytes]) -> SplatCloud:
    widths = {
        "POSITION": 3, f"{EXTENSION}:ROTATION": 4, f"{EXTENSION}:SCALE": 3, f"{EXTENSION}:OPACITY": 1,
        f"{EXTENSION}:SH_DEGREE_0_COEF_0": 3,
    }  # fmt: skip
    with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        try:
            position, turn, scale, opacity, harmonics = glb_attributes(content, widths)
        except ValueError as error:
            raise _damaged(path, "one primitive of Gaussians in a binary glTF file", error) from error
        rgb = harmonics * np.float32(SH_C0) + np.float32(0.5)
        return SplatCloud(position, scale, turn[:, [3, 0, 1, 2]], opacity[:, 0], rgb, "rub")


# ---- SPZ -------------------------------------------------------------------------------------------------------------


def _read_spz(path: Path, stream: IO[bytes]) -> SplatCloud:
    start = stream.read(4)
    if start == struct.pack("<I", spz.MAGIC):
        raise _damaged(path, "SPZ 2 or 3", "version 4, whose parts are packed by zstd")
    stream.seek(0)
    try:
        magic, version, count, degree, bits, *_ = struct.unpack("<IIIBBBB", next(_inflated(stream, 16), b""))
    except (zlib.error, struct.error) as error:
        raise _damaged(path, "an SPZ file, packed by gzip", error) from error
    if magic != spz.MAGIC or version not in (2, 3) or degree not in _SH_BANDS or not bits <= spz.POSITION_BITS:
        raise _damaged(path, "a header of SPZ 2 or 3", f"version {version}, degree {degree}, {bits} bits")
    turn_bytes = 4 if version == 3 else 3
    wanted = 16 + count * (16 + turn_bytes + 3 * _SH_BANDS[degree])
    if wanted > SPZ_RATIO_MAX * path.stat().st_size:
        raise _damaged(path, f"at most {SPZ_RATIO_MAX} times its size unpacked", f"{count} Gaussians")
    # counted before memory is taken for it: a file that is cut off, or longer than it says, costs nothing
    if (there := _length(path, stream, wanted)) != wanted:
        raise _damaged(path, f"{wanted} bytes unpacked, as its header says", "more" if there > wanted else there)
    stream.seek(0)
    content = np.frombuffer(b"".join(_inflated(stream)), np.uint8)
    parts, at = [], 16
    for width in (9, 1, 3, 3, turn_bytes):
        parts.append(content[at : at + count * width].reshape(count, width))
        at += count * width
    positions, alphas, colours, sizes, turns = parts
    whole = np.zeros((count, 3, 4), np.uint8)
    whole[..., 1:] = positions.reshape(count, 3, 3)
    harmonics = (colours / np.float32(255) - np.float32(0.5)) / np.float32(SPZ_COLOUR_SCALE)
    return SplatCloud(
        (whole.view("<i4")[..., 0] >> 8) / np.float32(2**bits),
        np.exp(sizes / np.float32(spz.STEPS_PER_LN) + np.float32(SPZ_LN_SIGMA_MIN)),
        (spz.unpacked_smallest_three if version == 3 else _first_three)(np.ascontiguousarray(turns)),
        alphas[:, 0] / np.float32(255),
        harmonics * np.float32(SH_C0) + np.float32(0.5),
        "rub",
    )


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
        raise _damaged(path, "an SPZ file, packed by gzip", error) from error
    return length


def _first_three(turns: np.ndarray) -> np.ndarray:
    """(N, 4) w, x, y, z from the three bytes of SPZ 2."""
    xyz = turns / np.float32(127.5) - 1
    w = np.sqrt(np.maximum(0, 1 - np.square(xyz).sum(1, keepdims=True)))
    return np.concatenate([w, xyz], 1)


_READERS: dict[str, Callable[[Path, IO[bytes]], SplatCloud]] = {
    ".ply": _read_ply,
    ".splat": _read_splat,
    ".glb": _read_glb,
    ".spz": _read_spz,
}
