"""Whether a file can be a USD stage at all, before USD reads it."""

from __future__ import annotations

import struct
import zipfile
from pathlib import Path

from jghand_engine.errors import InputError
from jghand_engine.limits import USD_CRATE_HEADER_BYTES

SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
CRATE, TEXT = b"PXR-USDC", b"#usda"


def check_file(path: Path) -> None:
    """InputError for a file that is absent, of another kind, or cut off before its table of contents."""
    thing = f"USD file {path}"
    if not path.is_file():
        raise InputError(thing, wanted="a file", came="none of that name", remedy="Check the name.")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(thing, wanted=" or ".join(SUFFIXES), came=path.suffix or "no suffix")
    try:
        with path.open("rb") as stream:
            start = stream.read(USD_CRATE_HEADER_BYTES)
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check its rights.") from error
    if path.suffix.lower() == ".usdz":
        _check_archive(path, thing)
    elif start.startswith(CRATE):
        _check_crate(start, path.stat().st_size, thing)
    elif not start.startswith(TEXT):
        raise InputError(thing, wanted=f"a beginning of {TEXT.decode()} or {CRATE.decode()}", came=repr(start[:8])[1:])


def _check_crate(start: bytes, size: int, thing: str) -> None:
    if len(start) < USD_CRATE_HEADER_BYTES:
        raise InputError(thing, wanted=f"at least {USD_CRATE_HEADER_BYTES} bytes", came=str(len(start)))
    (contents,) = struct.unpack_from("<q", start, 16)
    if not USD_CRATE_HEADER_BYTES <= contents < size:
        raise InputError(
            thing,
            wanted=f"a table of contents, at byte {contents}",
            came=f"only {size} bytes",
            remedy="The file was cut off: copy or export it again.",
        )


def _check_archive(path: Path, thing: str) -> None:
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError) as error:
        raise InputError(thing, wanted="a .usdz, which is a zip", came=str(error)) from error
    if not entries or Path(entries[0].filename).suffix.lower() not in SUFFIXES[:3]:
        came = entries[0].filename if entries else "no file"
        raise InputError(thing, wanted="a USD layer as the first file of the zip", came=came)
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise InputError(thing, wanted="files that are stored", came="compressed ones", remedy="Pack it without.")
