"""Whether a USD file, and what it refers to, can be given to USD at all, and what USD's errors about it mean.

USD reads text by recursion: what is deep enough ends the process. So everything that it would open is looked at first,
and what leads it to places that cannot be known beforehand is refused.
"""

from __future__ import annotations

import contextlib
import mmap
import re
import struct
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from jghand_engine.errors import InputError
from jghand_engine.limits import USD_CRATE_HEADER_BYTES, USD_TEXT_DEPTH_MAX

SUFFIXES = (".usda", ".usdc", ".usd", ".usdz")
CRATE, TEXT = b"PXR-USDC", b"#usda"
_CLOSING = (b"}", b")", b"]")

# brackets, and whatever may hold some that are none: strings, asset paths, comments. What is not closed goes on to the
# end, as nothing after it is read. Nothing here goes back, so the time is that of the length. Rows of vectors, most of
# a large file, are one token: ten times faster
_TOKENS = re.compile(
    rb'"""(?:[^"\\]++|\\.|"(?!""))*+(?:"""|\Z)'
    rb"|'''(?:[^'\\]++|\\.|'(?!''))*+(?:'''|\Z)"
    rb'|"(?:[^"\\\n]++|\\.)*+"?'
    rb"|'(?:[^'\\\n]++|\\.)*+'?"
    rb"|@@@(?:[^@\\]++|\\@@@|\\|@(?!@@))*+(?:@@@|\Z)"
    rb"|@[^@\n]*+@?"
    rb"|#[^\n]*+|//[^\n]*+|/\*(?:[^*]++|\*(?!/))*+(?:\*/|\Z)"
    rb"|(?:\([^][(){}\"'@#/]*+\)[,\s]*+)++"
    rb"|([{(\[])|[})\]]",
    re.DOTALL,
)


@contextlib.contextmanager
def reading(path: Path) -> Iterator[None]:
    """Meanwhile USD may open the stage at `path`. InputError for a file that is absent, of another kind, cut off before
    its table of contents, or so deep that USD would not come back from it, also where a layer is that it refers to; and
    for what USD says itself: it finds much of what is damaged only when it comes to it."""
    from pxr import Tf

    try:
        layers = _checked(path)
        yield
        del layers  # as long as they are held, USD need not read them again
    except Tf.ErrorException as error:
        came = f"a damaged one, or one with damaged layers: {usd_reason(error)}"
        raise InputError(f"USD file {path}", wanted="one that USD can read", came=came) from error


def usd_reason(error: Exception) -> str:
    """What went wrong first, of a Tf.ErrorException, without where in USD's source."""
    text = str(error).strip()
    quoted = re.search(r" in file \S+ : '(.*?)'\s*(?:\n\tError in '|\Z)", text, re.DOTALL)
    return (quoted.group(1) if quoted else text).strip()


def _checked(root: Path) -> list[Any]:
    """The layers of `root`, as far as they can be opened. Those that are absent are left to USD to tell."""
    from pxr import Ar, Sdf, Tf

    if not root.is_file():
        raise InputError(f"USD file {root}", wanted="a file", came="none of that name", remedy="Check the name.")
    if root.suffix.lower() not in SUFFIXES:
        raise InputError(f"USD file {root}", wanted=" or ".join(SUFFIXES), came=root.suffix or "no suffix")
    layers: list[Any] = []
    waiting, seen, files = [str(root)], {str(root)}, set()
    while waiting:
        place = waiting.pop()
        file = Path(Ar.SplitPackageRelativePathOuter(place)[0])
        if file not in files:
            _check(file)
            files.add(file)
        try:
            layer = Sdf.Layer.FindOrOpen(place)
        except Tf.ErrorException:  # said when the stage is opened
            continue
        if layer is not None:
            layers.append(layer)
            new = set(_references(layer, root)) - seen
            seen |= new
            waiting += new
    return layers


def _references(layer: Any, root: Path) -> Iterator[str]:
    """Where the layers are that a layer names: files, or in packages."""
    from pxr import Ar, Sdf, UsdUtils

    if layer.expressionVariables:
        raise InputError(
            f"USD file {root}", wanted="no expressionVariables, with which names of files change",
            came=f"some in {layer.identifier}", remedy="Flatten it, or write the names out.",
        )  # fmt: skip
    for names in UsdUtils.ExtractExternalReferences(layer.identifier):
        for name in names:
            place, words = Sdf.Layer.SplitIdentifier(Sdf.ComputeAssetPathRelativeToLayer(layer, name))
            if words:
                raise InputError(
                    f"USD file {root}", wanted="references to files alone", came=f"one with words for USD: {name}",
                    remedy="Leave out what follows :SDF_FORMAT_ARGS: in it.",
                )  # fmt: skip
            outer, inner = Ar.SplitPackageRelativePathOuter(place)
            if all(Path(one).suffix.lower() in SUFFIXES for one in (outer, inner or outer)):
                found = str(Ar.GetResolver().Resolve(place))
                if Path(Ar.SplitPackageRelativePathOuter(found)[0]).is_file():
                    yield found


def _check(path: Path) -> None:
    thing = f"USD file {path}"
    try:
        if path.suffix.lower() == ".usdz":
            _check_package(path, thing)
            return
        with path.open("rb") as stream:
            start = stream.read(USD_CRATE_HEADER_BYTES)
            if start.startswith(CRATE):
                _check_crate(start, path.stat().st_size, thing)
            elif start.startswith(TEXT):
                with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
                    check_depth(content, thing)
            else:
                wanted = f"a beginning of {TEXT.decode()} or {CRATE.decode()}"
                raise InputError(thing, wanted=wanted, came=repr(start[:8])[1:])
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror or error}", remedy="Check its rights.") from error


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


def _check_package(path: Path, thing: str) -> None:
    from pxr import Sdf

    try:
        zipfile.ZipFile(path).close()  # the directory at the end tells that it is whole
        # USD goes by what stands before each file, which need not be the same
        package = Sdf.ZipFile.Open(str(path))
        names = package.GetFileNames() if package else []
    # what zipfile raises of damaged directories; NotImplementedError is a RuntimeError
    except (zipfile.BadZipFile, ValueError, RuntimeError, EOFError, struct.error) as error:
        raise InputError(thing, wanted="a .usdz, which is a zip", came=str(error) or type(error).__name__) from error
    suffixes = [Path(name).suffix.lower() for name in names]
    if not names or suffixes[0] not in SUFFIXES[:3]:
        came = names[0] if names else "no file"
        raise InputError(thing, wanted="a USD layer as the first file of the zip", came=came)
    if ".usdz" in suffixes:
        raise InputError(thing, wanted="files", came="a .usdz within it", remedy="Pack its files themselves.")
    about = [package.GetFileInfo(name) for name in names]
    if any(one.compressionMethod != zipfile.ZIP_STORED for one in about):
        raise InputError(thing, wanted="files that are stored", came="compressed ones", remedy="Pack it without.")
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as content:
        for one in about:
            if content[one.dataOffset : one.dataOffset + len(TEXT)] == TEXT:
                check_depth(content, thing, one.dataOffset, one.dataOffset + one.size)


def check_depth(content: bytes | mmap.mmap, thing: str, first: int = 0, last: int | None = None) -> None:
    """InputError for a text layer, from byte `first` to before `last`, with too many brackets within each other."""
    depth = 0
    for token in _TOKENS.finditer(content, first, len(content) if last is None else last):
        if token.lastindex:
            depth += 1
            if depth > USD_TEXT_DEPTH_MAX:
                raise InputError(thing, wanted=f"at most {USD_TEXT_DEPTH_MAX} brackets open at once", came="more")
        elif token.group() in _CLOSING:
            depth -= 1
