"""One process per piece of work: locks that the system takes back when their process ends, however it ends."""

from __future__ import annotations

import contextlib
import errno
import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.files import file_error
from jghand_engine.limits import CLAIM_POLL_S, LOCK_HOLDER_BYTES, LOCK_POLL_S


@contextlib.contextmanager
def locked(
    path: Path, *, work: str = "work", remedy: str = "Wait until it has ended.",
    waits: Callable[[RetryError], bool] = lambda _: False,
) -> Iterator[None]:  # fmt: skip
    """Holds the lock file `path` for the duration. RetryError when another process (or thread) holds it; InputError
    where the file system has no locks, as nobody else could be kept out.

    work: what is done meanwhile, for the error · waits: given that error again and again while another holds it; says
    whether to wait for it a little longer
    """
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
    except OSError as error:
        raise file_error(path, error) from error
    try:
        while not _taken(descriptor, path.parent):
            held = RetryError(
                f"{path.parent}", wanted=f"a folder in which no other {work} is under way",
                came=f"one in use by process {_holder(descriptor)}",
                remedy=remedy,
            )  # fmt: skip
            if not waits(held):
                raise held
            time.sleep(LOCK_POLL_S)
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


class Claims:
    """Which of many numbered pieces of work a process is at: a byte of one file for each. Processes exclude each other,
    also on different machines where their file system passes locks on; threads of one process do not, and only one
    `Claims` of a file may be open in a process.

    Where a file system has no such locks every claim is granted: whoever relies on claims must be right without them.
    sure: whether all claims so far were locks.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.sure = path, True
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_CREAT, 0o666)
        except OSError as error:
            raise file_error(path, error) from error

    @contextlib.contextmanager
    def held(self, number: int, *, wait_s: float = 0.0) -> Iterator[bool]:
        """Claims piece `number`, 0 or more, for the duration; gives whether it was free. wait_s: how long at most until
        it is."""
        until_s = time.monotonic() + wait_s
        taken = self._take(number)
        while not taken and time.monotonic() < until_s:
            time.sleep(CLAIM_POLL_S)
            taken = self._take(number)
        try:
            yield taken
        finally:
            if taken:
                with contextlib.suppress(OSError):
                    _release_byte(self._descriptor, number)

    def close(self) -> None:
        """Gives everything back; the file goes where nobody else holds a piece, or nobody can."""
        alone = True
        try:
            _take_bytes(self._descriptor, 0, _ALL_BYTES)
        except OSError as error:
            alone = error.errno not in _TAKEN
        os.close(self._descriptor)
        if alone:
            with contextlib.suppress(OSError):
                self.path.unlink()

    def _take(self, number: int) -> bool:
        try:
            _take_bytes(self._descriptor, number, 1)
        except OSError as error:
            if error.errno in _TAKEN:
                return False
            self.sure = False
        return True


# what the systems say of what another process holds
_TAKEN = (errno.EACCES, errno.EAGAIN, errno.EDEADLK)
# ... and where a file system knows no locks, or nobody who keeps them
_NO_LOCKS = (errno.ENOSYS, errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOTSUP)


if sys.platform == "win32":
    import msvcrt

    _ALL_BYTES = 2**31 - 1

    def _take_bytes(descriptor: int, first: int, count: int) -> None:
        os.lseek(descriptor, first, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, count)

    def _release_byte(descriptor: int, number: int) -> None:
        os.lseek(descriptor, number, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_UNLCK, 1)

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

    # to the system 0 bytes are all that follow
    _ALL_BYTES = 0

    def _take_bytes(descriptor: int, first: int, count: int) -> None:
        fcntl.lockf(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB, count, first)

    def _release_byte(descriptor: int, number: int) -> None:
        fcntl.lockf(descriptor, fcntl.LOCK_UN, 1, number)

    def _take(descriptor: int) -> bool:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if error.errno in _TAKEN:
                return False
            raise
        return True
