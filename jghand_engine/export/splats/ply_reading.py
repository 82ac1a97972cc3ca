"""Gaussians of PLY files of anybody: little-endian, vertices first, then elements of fixed size, which are left out."""

from __future__ import annotations

import re
from pathlib import Path
from typing import IO

import numpy as np

from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.rows import SplatRows, damaged
from jghand_engine.limits import PLY_HEADER_BYTES_MAX, SH_C0

_TYPES = {"float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8", "uchar": "u1", "uint8": "u1",
          "char": "i1", "int8": "i1", "ushort": "<u2", "uint16": "<u2", "short": "<i2", "int16": "<i2",
          "uint": "<u4", "uint32": "<u4", "int": "<i4", "int32": "<i4"}  # fmt: skip
_WANTED = ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2",
           "rot_0", "rot_1", "rot_2", "rot_3")  # fmt: skip


def ply_rows(path: Path, stream: IO[bytes]) -> SplatRows:
    """The Gaussians of an open file. InputError, which names it, for one that is damaged or lies."""
    header, start = _header(path, stream)
    (name, count, row), *others = _elements(path, header) or [("none", 0, np.dtype([]))]
    if name != "vertex" or not row.names:
        raise damaged(path, "properties of the element vertex first", f"{name} of {len(row.names or ())}")
    wanted = start + count * row.itemsize + sum(number * other.itemsize for _, number, other in others)
    if wanted != (there := path.stat().st_size):
        raise damaged(path, f"{wanted} bytes, as its header says ({count} vertices)", there)
    if missing := [name for name in _WANTED if name not in row.names]:
        raise damaged(path, f"properties {', '.join(missing)} of a vertex, as splats have them", "none of that name")
    table = np.memmap(stream, row, "r", start, (count,)) if count else np.zeros(0, row)
    said = re.search(r"^comment JGHand .*axes=(rdf|rub)\b", header, re.MULTILINE)
    axes = said[1] if said else ""

    def part(rows: slice) -> SplatCloud:
        def columns(*names: str) -> np.ndarray:
            return np.stack([table[name][rows].astype(np.float32) for name in names], -1)

        with np.errstate(over="ignore"):
            return SplatCloud(
                columns("x", "y", "z"),
                np.exp(columns("scale_0", "scale_1", "scale_2")),
                columns("rot_0", "rot_1", "rot_2", "rot_3"),
                1 / (1 + np.exp(-columns("opacity")[:, 0])),
                columns("f_dc_0", "f_dc_1", "f_dc_2") * np.float32(SH_C0) + np.float32(0.5),
                axes,
            )

    return SplatRows(path, count, axes, part)


def _header(path: Path, stream: IO[bytes]) -> tuple[str, int]:
    """The header's text, and where the data begin."""
    beginning = stream.read(PLY_HEADER_BYTES_MAX)
    found = re.match(rb"ply\r?\n(?s:.*?)\nend_header\r?\n", beginning)
    if not found:
        raise damaged(path, f"a PLY header of at most {PLY_HEADER_BYTES_MAX} bytes", repr(beginning[:20]))
    try:
        return found[0].decode("ascii").replace("\r", ""), found.end()
    except UnicodeDecodeError:
        raise damaged(path, "a PLY header in plain letters", "others") from None


def _elements(path: Path, header: str) -> list[tuple[str, int, np.dtype]]:
    """Name, count, and what one of them holds."""
    lines = [line.split() for line in header.splitlines() if line.split()[:1] not in ([], ["comment"], ["obj_info"])]
    if lines[1:2] != [["format", "binary_little_endian", "1.0"]]:
        raise damaged(path, "format binary_little_endian 1.0", " ".join(lines[1]) if len(lines) > 1 else "none")
    elements: list[tuple[str, int, dict[str, str]]] = []
    for words in lines[2:-1]:
        if words[0] == "element":
            if len(words) != 3 or not re.fullmatch(r"\d{1,12}", words[2]):
                raise damaged(path, "elements with a name and a count", " ".join(words))
            elements.append((words[1], int(words[2]), {}))
            continue
        fields = elements[-1][2] if elements else None
        if fields is None or len(words) != 3 or words[0] != "property" or words[1] not in _TYPES or words[2] in fields:
            raise damaged(path, "elements with properties of one number each, each once", " ".join(words))
        fields[words[2]] = _TYPES[words[1]]
    return [(name, count, np.dtype(list(fields.items()))) for name, count, fields in elements]
