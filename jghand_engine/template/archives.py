"""Reading .npz files whose content is not trusted: numbers and text only, and never more memory than the file has."""

from __future__ import annotations

import io
import math
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np
from numpy.lib import format as npy

from jghand_engine.errors import InputError
from jghand_engine.limits import NPZ_MEMBER_BYTES_MAX

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
# what zipfile and numpy raise on damaged files; numpy parses an array's header as a Python literal
_DAMAGE = (
    *(OSError, ValueError, TypeError, EOFError, KeyError, OverflowError, RuntimeError, NotImplementedError),
    *(SyntaxError, tokenize.TokenError, struct.error, zipfile.BadZipFile, zlib.error),
)


def read_arrays(source: Path | Traversable, names: Collection[str], thing: str) -> dict[str, np.ndarray]:
    """The arrays `names` of the .npz file `source`, which errors call `thing`.

    InputError when the file cannot be read, its checksums do not fit, an array is missing, is no plain numbers or text,
    or is larger than NPZ_MEMBER_BYTES_MAX or than its own bytes.
    """
    try:
        with source.open("rb") as stream, zipfile.ZipFile(stream) as archive:
            missing = sorted(set(names) - {name.removesuffix(".npy") for name in archive.namelist()})
            if missing:
                raise InputError(thing, wanted=f"fields {', '.join(missing)}", came="none of that name")
            return {name: _read_member(archive, name, thing) for name in names}
    except _DAMAGE as error:
        raise InputError(thing, wanted="a whole .npz file", came=f"{type(error).__name__}: {error}"[:200]) from error


def _read_member(archive: zipfile.ZipFile, name: str, thing: str) -> np.ndarray:
    """One array. Numpy's own reader reserves what the header promises before it looks whether the bytes are there."""
    member = archive.getinfo(f"{name}.npy")
    if member.file_size > NPZ_MEMBER_BYTES_MAX:
        raise InputError(f"{thing}, {name}", wanted=f"at most {NPZ_MEMBER_BYTES_MAX} bytes", came="more")
    # reading to the end compares the checksum
    stream = io.BytesIO(archive.read(member))
    read_header = _HEADERS.get(npy.read_magic(stream))
    if read_header is None:
        raise InputError(f"{thing}, {name}", wanted="an array of version 1 or 2", came="another")
    shape, column_major, dtype = read_header(stream)
    if dtype.kind not in "biufU":
        raise InputError(f"{thing}, {name}", wanted="plain numbers or text", came=f"type {dtype.str}")
    rest = stream.read()
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != len(rest):
        raise InputError(f"{thing}, {name}", wanted=f"the bytes of an array {shape}", came=f"{len(rest)}")
    return np.frombuffer(rest, dtype=dtype).reshape(shape, order="F" if column_major else "C").copy()
