# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that appear under their name only when they are whole. Does not use bpy."""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

from ..errors import JGHandFailure

# how long a file that somebody else looks at is waited for before it is replaced, on Windows, seconds
REPLACE_RESTS_S = (0.02, 0.05, 0.1, 0.2)


def write_whole(path: Path, content: bytes) -> None:
    """Writes a file under a temporary name, then renames it. JGHandFailure: cannot_write, disk_full."""
    with _arriving(path) as temporary:
        with temporary.open("wb") as stream:
            stream.write(content)
            stream.flush()
            os.fsync(stream.fileno())
        temporary.chmod(0o644)


def copy_whole(source: Path, path: Path) -> None:
    """Copies a file, its time too, under a temporary name, then renames it: what was at `path` stays until then.
    JGHandFailure: cannot_write, disk_full."""
    with _arriving(path) as temporary:
        shutil.copy2(source, temporary)


@contextlib.contextmanager
def _arriving(path: Path) -> Iterator[Path]:
    """A temporary file beside `path`, of this process alone, that takes its place in the end."""
    temporary = None
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{path.stem}.", suffix=".part", dir=path.parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        _replace(temporary, path)
    except OSError as error:
        kind = "disk_full" if error.errno in (errno.ENOSPC, getattr(errno, "EDQUOT", -1)) else "cannot_write"
        raise JGHandFailure(kind, f"{path}: {error.strerror or error}") from error
    finally:
        if temporary is not None:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)


def _replace(temporary: Path, path: Path) -> None:
    """Renames over what may be there. Windows refuses that while somebody, a virus scanner or an index, looks at it."""
    for rest_s in REPLACE_RESTS_S if sys.platform == "win32" else ():
        try:
            os.replace(temporary, path)
        except PermissionError:
            time.sleep(rest_s)
        else:
            return
    os.replace(temporary, path)
