"""Writing files so that nothing is ever half-written: a temporary name beside the target, then one rename. And where a
user's caches lie."""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.errors import DiskFullError, InputError, JGHandError, RetryError


def file_error(path: Path, error: OSError) -> JGHandError:
    """The JGHandError that says what an OSError on `path` means to a user."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return DiskFullError(f"cannot write {path}: the disk is full", remedy="Free some space and try again.")
    if error.errno in (errno.EACCES, errno.EPERM, errno.EROFS):
        return InputError(f"cannot write {path}: permission denied", remedy="Choose a folder that you may write to.")
    if error.errno in (errno.ENOTDIR, errno.EEXIST, errno.EISDIR):
        return InputError(
            f"cannot write {path}: a file or folder of that name is in the way", remedy="Choose another name."
        )
    return RetryError(f"cannot write {path}: {error.strerror or error}", remedy="Check the disk and try again.")


# of what JGHand writes into folders: whoever gives a folder such a name meant the file
FILE_SUFFIXES = frozenset(
    (".png", ".exr", ".mp4", ".ply", ".splat", ".glb", ".spz", ".sog", ".usd", ".usda", ".usdc", ".usdz", ".html")
)


def make_folder(path: Path | str) -> Path:
    """Creates `path` with its parents; a typed error says why it cannot be, or that it is called like a file."""
    folder = Path(path)
    if folder.suffix.lower() in FILE_SUFFIXES and not folder.exists():
        raise InputError(
            f"{folder}", wanted="the name of a folder", came="that of a file", remedy=f"Say {folder.with_suffix('')}."
        )
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise file_error(folder, error) from error
    return folder


def cache_folder() -> Path:
    """Where this user's caches are kept; JGHAND_CACHE_DIR names another place."""
    if named := os.environ.get("JGHAND_CACHE_DIR"):
        return Path(named)
    try:
        home = Path.home()
    except RuntimeError:  # a user without a home, as in some containers
        home = Path(tempfile.gettempdir())
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or home / "AppData" / "Local") / "jghand" / "cache"
    if sys.platform == "darwin":
        return home / "Library" / "Caches" / "jghand"
    return Path(os.environ.get("XDG_CACHE_HOME") or home / ".cache") / "jghand"


def check_place(path: Path, *, overwrite: bool, wanted: str = "a new file", option: str = "--out") -> None:
    """For --out of a command that takes long, or another `option`: looks at the start whether `path` can be written at
    the end.

    InputError when a file is there that nobody asked to overwrite, or a folder; as `writing` where the folder of `path`
    cannot be written.
    """
    if path.is_dir() or (path.exists() and not overwrite):
        came = "a folder" if path.is_dir() else "another file"
        remedy = "Name another file" + ("." if path.is_dir() else ", or replace that one with --overwrite.")
        raise InputError(f"{option} {path}", wanted=wanted, came=came, remedy=remedy)
    folder = make_folder(path.parent)
    probe = folder / f".{path.stem}.{secrets.token_hex(6)}{path.suffix}"
    try:
        os.close(os.open(probe, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        probe.unlink()
    except OSError as error:
        raise file_error(path, error) from error


@contextlib.contextmanager
def writing(path: Path | str) -> Iterator[Path]:
    """Gives a temporary path in the target's folder; on success it is synced and renamed onto `path`.

    On any failure the temporary file is removed and a file already at `path` is left as it was. The temporary name
    keeps the suffix, because writers choose their format by it.
    """
    target = Path(path)
    make_folder(target.parent)
    temporary = target.parent / f".{target.stem}.{secrets.token_hex(6)}{target.suffix}"
    try:
        # made here and now, so that a folder without room or rights is told before the work; with the rights of any new
        # file, which tempfile's private ones are not
        os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
    except OSError as error:
        raise file_error(target, error) from error
    try:
        yield temporary
        sync(temporary)
        os.replace(temporary, target)
    except OSError as error:
        raise file_error(target, error) from error
    finally:
        with contextlib.suppress(FileNotFoundError):
            temporary.unlink()


def write_file(path: Path | str, content: bytes | str) -> None:
    """Whole or not at all, as `writing`; text in UTF-8, its line ends as they are."""
    with writing(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def remove_file(path: Path) -> None:
    """Where it is there. RetryError, InputError as `file_error`."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise file_error(path, error) from error


def read_bytes(path: Path) -> bytes:
    """The content of a file that the user named. InputError when it cannot be read."""
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"cannot read {path}: {error.strerror}", remedy="Check the name.") from error


def sync(path: Path) -> None:
    """Waits until what was written to the file `path` is on the disk; OSError when it does not get there."""
    # opened for writing: Windows refuses to sync what is only read
    with open(path, "rb+") as stream:
        os.fsync(stream.fileno())
