"""Arrays from .npz files that others may have written: numbers and text only, and never more than was allowed."""

from __future__ import annotations

import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from importlib.resources.abc import Traversable
from pathlib import Path

import numpy as np

from jghand_engine.errors import InputError

# all arrays together, unpacked, where the caller says nothing else: MANO has 30 MB of them
NPZ_BYTES_MAX = 64 * 2**20
# what zipfile and numpy raise on damaged files; numpy parses an array's header as a Python literal
_DAMAGE = (
    *(OSError, ValueError, TypeError, EOFError, KeyError, OverflowError, RuntimeError, NotImplementedError),
    *(MemoryError, SyntaxError, tokenize.TokenError, struct.error, zipfile.BadZipFile, zlib.error),
)


def read_arrays(
    source: Path | Traversable,
    names: Collection[str],
    name_of_file: str,
    *,
    optional: Collection[str] = (),
    max_bytes: int = NPZ_BYTES_MAX,
) -> dict[str, np.ndarray]:
    """The arrays `names` of the .npz file `source`, and those of `optional` that it has. Others are not looked at.

    Raises InputError, which calls the file `name_of_file`, when it cannot be read, its checksums do not fit, an array
    is missing or no plain numbers or text, or when all together take more than `max_bytes` unpacked.
    """
    try:
        with source.open("rb") as stream, zipfile.ZipFile(stream) as archive:
            present = {entry.filename.removesuffix(".npy"): entry for entry in archive.infolist()}
            missing = sorted(set(names) - set(present))
            if missing:
                raise InputError(name_of_file, wanted=f"fields {', '.join(missing)}", came="none of that name")
            entries = {name: present[name] for name in (*names, *optional) if name in present}
            if sum(entry.file_size for entry in entries.values()) > max_bytes:
                raise InputError(name_of_file, wanted=f"at most {max_bytes} bytes unpacked", came="more")
            arrays = {}
            for name, entry in entries.items():
                with archive.open(entry) as member:
                    arrays[name] = np.lib.format.read_array(member, allow_pickle=False)
                    # reading to the end compares the checksum
                    if member.read(1):
                        raise ValueError(f"{name} is longer than its header says")
    except _DAMAGE as error:
        came = f"{type(error).__name__}: {error}"[:200]
        raise InputError(name_of_file, wanted="a whole .npz file", came=came) from error
    for name, array in arrays.items():
        if array.dtype.kind not in "biufU":
            raise InputError(f"{name_of_file}, {name}", wanted="plain numbers or text", came=f"type {array.dtype.str}")
    return arrays
