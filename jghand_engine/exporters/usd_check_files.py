"""Whether a file can be a USD stage at all, before USD reads it, and what USD's errors about it mean."""

from __future__ import annotations

import contextlib
import mmap
import re
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path

from pxr import Sdf, Tf, UsdUtils

from jghand_engine.errors import InputError
from jghand_engine.exporters.usd_layers import usd_reason
from jghand_engine.limits import USD_CRATE_HEADER_BYTES, USD_TEXT_DEPTH_MAX

SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
CRATE, TEXT = b"PXR-USDC", b"#usda"
CLOSING = (b"}", b")", b"]")

# brackets, and whatever may hold some that are none: strings, asset paths, comments. What is not closed goes on to the
# end, as nothing after it is read. Nothing here goes back, so the time is that of the length
_TOKENS = re.compile(
    rb'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"""|\Z)'
    rb"|'''(?:[^'\\]++|\\.|'(?!''))*+(?:'''|\Z)"
    rb'|"(?:[^"\\\n]++|\\.)*+"?'
    rb"|'(?:[^'\\\n]++|\\.)*+'?"
    rb"|@@@(?:[^@\\]++|\\@@@|\\|@(?!@@))*+(?:@@@|\Z)"
    rb"|@[^@\n]*+@?"
    rb"|#[^\n]*+|//[^\n]*+|/\*(?:[^*]++|\*(?!/))*+(?:\*/|\Z)"
    rb"|([{(\[])|[})\]]",
    re.DOTALL,
)


@contextlib.contextmanager
def refusing(path: Path) -> Iterator[None]:
    """Turns what USD says while it reads `path`, and layers that belong to it, into InputError: it finds much of what
    is damaged only when it comes to it."""
    try:
        yield
    except Tf.ErrorException as error:
        came = f"a damaged one, or one with damaged layers: {usd_reason(error)}"
        raise InputError(f"USD file {path}", wanted="one that USD can read", came=came) from error


def check_file(path: Path) -> None:
    """InputError for a file that is absent, of another kind, cut off before its table of contents, or so deep that USD
    would not come back from it; also where a layer is that it refers to."""
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
    _check_depths(path)


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
    with _archive(path, thing) as archive:
        entries = archive.infolist()
    if not entries or Path(entries[0].filename).suffix.lower() not in SUFFIXES[:3]:
        came = entries[0].filename if entries else "no file"
        raise InputError(thing, wanted="a USD layer as the first file of the zip", came=came)
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise InputError(thing, wanted="files that are stored", came="compressed ones", remedy="Pack it without.")


@contextlib.contextmanager
def _archive(path: Path, thing: str) -> Iterator[zipfile.ZipFile]:
    try:
        with zipfile.ZipFile(path) as archive:
            yield archive
    # what zipfile raises of damaged directories and files; NotImplementedError is a RuntimeError
    except (zipfile.BadZipFile, OSError, ValueError, RuntimeError, EOFError, struct.error) as error:
        raise InputError(thing, wanted="a .usdz, which is a zip", came=str(error) or type(error).__name__) from error


def _check_depths(root: Path) -> None:
    """InputError where `root`, or a text layer that it refers to, however far, is too deep. Others that are absent or
    damaged are left to USD to tell."""
    waiting, seen = [root], {root}
    while waiting:
        path = waiting.pop()
        _check_depth(path)
        new = {one for one in _references(path) - seen if one.suffix.lower() in SUFFIXES and one.is_file()}
        seen |= new
        waiting += new


def _references(path: Path) -> set[Path]:
    """The files that a layer names."""
    try:
        layer = Sdf.Layer.FindOrOpen(str(path))
        kinds = UsdUtils.ExtractExternalReferences(str(path)) if layer else ()
    except Tf.ErrorException:
        return set()
    return {Path(Sdf.ComputeAssetPathRelativeToLayer(layer, name)) for names in kinds for name in names}


def _check_depth(path: Path) -> None:
    thing = f"USD file {path}"
    if path.suffix.lower() == ".usdz":
        with _archive(path, thing) as archive:
            for entry in archive.infolist():
                with archive.open(entry) as stream:
                    is_text = stream.read(len(TEXT)) == TEXT
                if is_text:
                    _count_brackets(archive.read(entry), thing)
        return
    with path.open("rb") as stream:
        if stream.read(len(TEXT)) == TEXT:
            with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                _count_brackets(content, thing)


def _count_brackets(content: bytes | mmap.mmap, thing: str) -> None:
    depth = 0
    for token in _TOKENS.finditer(content):
        if token.lastindex:
            depth += 1
            if depth > USD_TEXT_DEPTH_MAX:
                raise InputError(thing, wanted=f"at most {USD_TEXT_DEPTH_MAX} brackets open at once", came="more")
        elif token.group() in CLOSING:
            depth -= 1
