"""Reading .npz files whose content is not trusted: numbers and text only.

What a file claims about itself is compared with a limit and with the bytes that are there before memory is taken for
it, so that a small file cannot ask for much.
"""

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
from jghand_engine.limits import NPZ_BYTES_MAX

_HEADERS = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
# what zipfile and numpy raise on damaged files; numpy parses an array's header as a Python literal
_DAMAGE = (
    *(OSError, ValueError, TypeError, EOFError, KeyError, OverflowError, RuntimeError, NotImplementedError),
    *(SyntaxError, tokenize.TokenError, struct.error, zipfile.BadZipFile, zlib.error),
)


def read_arrays(
    source: Path | Traversable,
    names: Collection[str],
    thing: str,
    *,
    optional: Collection[str] = (),
    max_bytes: int = NPZ_BYTES_MAX,
) -> dict[str, np.ndarray]:
    """The arrays `names` of the .npz file `source`, which errors call `thing`, and those of `optional` that it has.

    Other arrays are not looked at. InputError when the file cannot be read, its checksums do not fit, an array is
    missing, is no plain numbers or text or not as long as its header says, when all together take more than `max_bytes`
    unpacked, or when they are packed in another way than numpy's.
    """
    try:
        with source.open("rb") as stream, zipfile.ZipFile(stream) as archive:
            present = {name.removesuffix(".npy") for name in archive.namelist()}
            missing = sorted(set(names) - present)
            if missing:
                raise InputError(thing, wanted=f"fields {', '.join(missing)}", came="none of that name")
            wanted = [name for name in (*names, *optional) if name in present]
            members = {name: archive.getinfo(f"{name}.npy") for name in wanted}
            if sum(member.file_size for member in members.values()) > max_bytes:
                raise InputError(thing, wanted=f"at most {max_bytes} bytes unpacked", came="more")
            return {name: _read_member(archive, member, f"{thing}, {name}") for name, member in members.items()}
    except _DAMAGE as error:
        raise InputError(thing, wanted="a whole .npz file", came=f"{type(error).__name__}: {error}"[:200]) from error


def _read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo, thing: str) -> np.ndarray:
    """One array. Numpy's own reader reserves what the header promises before it looks whether the bytes are there."""
    # the other methods unpack a whole block, of up to gigabytes, whatever is asked for
    if member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        raise InputError(thing, wanted="an array stored or deflated", came=f"method {member.compress_type}")
    with archive.open(member) as packed:
        # not more than announced, however much there is; reading to the end compares the checksum
        content = packed.read(member.file_size)
    stream = io.BytesIO(content)
    read_header = _HEADERS.get(npy.read_magic(stream))
    if read_header is None:
        raise InputError(thing, wanted="an array of version 1 or 2", came="another")
    shape, column_major, dtype = read_header(stream)
    if dtype.kind not in "biufU":
        raise InputError(thing, wanted="plain numbers or text", came=f"type {dtype.str}")
    size = len(content) - stream.tell()
    if min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize != size:
        raise InputError(thing, wanted=f"the bytes of an array {shape}"[:200], came=f"{size}")
    return np.frombuffer(content, dtype, offset=stream.tell()).reshape(shape, order="F" if column_major else "C").copy()
