"""One process per piece of work: a lock that the system takes back when its process ends, however it ends."""

from __future__ import annotations

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from jghand_engine.errors import RetryError
from jghand_engine.files import file_error


@contextlib.contextmanager
def locked(path: Path, *, work: str = "work", remedy: str = "Wait until it has ended.") -> Iterator[None]:
    """Holds the lock file `path` for the duration. RetryError when another process (or thread) holds it.

    work: what is done meanwhile, for the error
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise file_error(path, error) from error
    try:
        if not _take(descriptor):
            holder = os.pread(descriptor, 20, 1).decode("ascii", "replace") if hasattr(os, "pread") else "unknown"
            raise RetryError(
                f"{path.parent}", wanted=f"a folder in which no other {work} is under way",
                came=f"one in use by process {holder.strip() or 'unknown'}",
                remedy=remedy,
            )  # fmt: skip
        # the first byte is what Windows locks and others then cannot read
        os.write(descriptor, f" {os.getpid():<12d}\n".encode())
        yield
    finally:
        # the file stays: removing it would let two others lock two files of the same name
        os.close(descriptor)


if sys.platform == "win32":
    import msvcrt

    def _take(descriptor: int) -> bool:
        try:
            os.lseek(descriptor, 0, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError:
            return False
        os.lseek(descriptor, 0, os.SEEK_SET)
        return True

else:
    import fcntl

    def _take(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True
