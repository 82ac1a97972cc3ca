"""One process per piece of work: locks that the system takes back when their process ends, however it ends."""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.files import file_error

# bytes of a lock file for whoever holds it: a number and the name of a machine; fixed, so that a longer one before
# leaves nothing behind
LOCK_HOLDER_BYTES = 60


@contextlib.contextmanager
def locked(
    path: Path, *, work: str = "work", remedy: str = "Wait until it has ended.", wait_s: float = 0.0
) -> Iterator[None]:
    """Holds the lock file `path` for the duration. RetryError when another process (or thread) holds it; InputError
    where the file system has no locks, as nobody else could be kept out.

    work:   what is done meanwhile, for the error
    wait_s: how long another holder is waited for
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise file_error(path, error) from error
    until_s = time.monotonic() + wait_s
    try:
        while not _taken(descriptor, path.parent):
            if time.monotonic() < until_s:
                time.sleep(0.05)
                continue
            raise RetryError(
                f"{path.parent}", wanted=f"a folder in which no other {work} is under way",
                came=f"one in use by process {_holder(descriptor)}",
                remedy=remedy,
            )  # fmt: skip
        # the first byte is what Windows locks and others then cannot read
        who = f"{os.getpid()} on {platform.node()}"
        os.write(descriptor, f" {who:<{LOCK_HOLDER_BYTES}.{LOCK_HOLDER_BYTES}}\n".encode("ascii", "replace"))
        yield
    finally:
        # the file stays: removing it would let two others lock two files of the same name
        os.close(descriptor)


def _taken(descriptor: int, folder: Path) -> bool:
    try:
        return _take(descriptor)
    except OSError as error:
        raise _no_locks(folder, error) from error


def _holder(descriptor: int) -> str:
    """Who wrote itself into a lock file: its number, and the machine on which that number is its."""
    said = os.pread(descriptor, LOCK_HOLDER_BYTES, 1).decode("ascii", "replace") if hasattr(os, "pread") else ""
    return said.partition("\n")[0].strip() or "unknown"


def _no_locks(folder: Path, error: OSError) -> JGHandError:
    if error.errno not in _NO_LOCKS:
        return file_error(folder, error)
    return InputError(
        f"{folder}", wanted="a file system with locks", came=error.strerror or str(error),
        remedy="Mount it with them (Lustre: -o flock; NFS: its lock daemon), or choose a folder on another disk.",
    )  # fmt: skip


# what the systems say of what another process holds
_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
# ... and where a file system knows no locks, or nobody who keeps them
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)


if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> bool:
        try:
            os.lseek(descriptor, 0, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:
            if error.errno in _TAKEN:
                return False
            raise
        os.lseek(descriptor, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def _take(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _TAKEN:
                return False
            raise
        return True
