# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether files changed, for what is drawn: a disk of the network that is gone keeps whoever asks it for seconds or for
ever, so threads ask, and what is drawn gets what they found last.

Does not use bpy.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from . import limits

# the stamp of a file whose disk has not answered yet
UNKNOWN = "unknown"


@dataclass
class _File:
    """stamp: found last · looked_s: when that look began, on the clock of time.monotonic() · busy: a thread looks now
    · found: it has looked · waited: somebody waited for the first look already"""

    stamp: str = UNKNOWN
    looked_s: float = float("-inf")
    busy: bool = False
    found: threading.Event = field(default_factory=threading.Event)
    waited: bool = False


class FileStamps:
    """Stamps of files. look: what changes with the file of a path; it may take as long as a disk takes."""

    def __init__(self, look: Callable[[str], str]) -> None:
        self._look = look
        self._lock = threading.Lock()
        self._files: dict[str, _File] = {}

    def get(self, path: str, *, fresh: bool = False) -> str:
        """The stamp of a file as it was a second ago, or later. The first time, and where it is to be `fresh`, a moment
        is waited for the disk; one that does not answer leaves the stamp as it was."""
        with self._lock:
            file = self._files.setdefault(path, _File())
        if fresh and file.busy:  # that look may have begun before the file changed
            file.found.wait(limits.FILE_WAIT_S)
        with self._lock:
            wait = fresh or not file.waited
            file.waited = True
            now_s = time.monotonic()
            if not file.busy and (fresh or now_s - file.looked_s >= limits.FILE_LOOK_S):
                file.looked_s, file.busy = now_s, True
                file.found.clear()
                threading.Thread(target=self._look_at, args=(path, file), daemon=True, name="jghand file").start()
        if wait:
            file.found.wait(limits.FILE_WAIT_S)
        return file.stamp

    def clear(self) -> None:
        """Forgets all files; looks that are under way end unseen."""
        with self._lock:
            self._files.clear()

    def _look_at(self, path: str, file: _File) -> None:
        try:
            file.stamp = self._look(path)
        finally:
            file.busy = False
            file.found.set()
