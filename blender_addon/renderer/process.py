# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's process and what it prints. Nothing here waits longer than its arguments allow. Does not use bpy.

The engine ends when its stdin does, so it cannot outlive this process, however that ends. Source: BLENDER 3.1 and 3.4.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import secrets
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from ..core import limits
from ..core.wire import protocol
from ..errors import JGHandFailure, kind_of_exit
from .programs import HIDDEN

# what Blender's own process would impose on another Python
_DROPPED = ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "LD_LIBRARY_PATH", "LD_PRELOAD", "OCIO")
_DROPPED_PREFIXES = ("DYLD_", "BLENDER_")
# what a Python says of a module that it has not; the name ends the line, or it is another module's
_NO_ENGINE = re.compile(r"No module named '?jghand_engine'?\s*$", re.MULTILINE)
_NO_MODULE = re.compile(r"^.*No module named .*$", re.MULTILINE)


def cleaned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment for a Python that is not Blender's. It says where `jghand capture` finds this extension."""
    kept = {
        name: value
        for name, value in environment.items()
        if name not in _DROPPED and not name.startswith(_DROPPED_PREFIXES)
    }
    return kept | {"JGHAND_BLENDER_ADDON": str(Path(__file__).resolve().parents[1])}


class EngineLog:
    """What one engine printed: the last lines here, all of them in a file where a folder for that is given.

    A new engine gets a new log: nothing that it does is explained with the words of the one before."""

    def __init__(self, folder: Path | None = None) -> None:
        """folder: where a new file is begun, and the oldest go."""
        self._lines: deque[str] = deque(maxlen=limits.LOG_LINES)
        # apart: whoever reads the lines does not wait for a disk
        self._lines_lock, self._file_lock = threading.Lock(), threading.Lock()
        self._file: IO[str] | None = None
        self._room = limits.LOG_FILE_MAX_BYTES
        self.path: Path | None = None
        if folder is not None:
            _remove_old(folder)
            self._open(folder)

    def _open(self, folder: Path) -> None:
        # the process's number keeps two Blenders of the same second apart
        path = folder / f"engine-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
        with contextlib.suppress(OSError):  # a log that cannot be written is no reason to have no engine
            folder.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a", encoding="utf-8", buffering=1)
            self.path = path

    @property
    def empty(self) -> bool:
        """Whether nothing was printed."""
        return not self._lines

    def write(self, line: str) -> None:
        """One line more, from any thread."""
        with self._lines_lock:
            self._lines.append(line)
        with self._file_lock:
            if self._file is None or self._room <= 0:
                return
            self._room -= len(line) + 1
            with contextlib.suppress(OSError):  # a full disk
                self._file.write(line + "\n" if self._room > 0 else "… the rest is left out\n")

    def end(self) -> None:
        """Closes the file; the lines stay."""
        with self._file_lock:
            file, self._file = self._file, None
            if file is not None:
                with contextlib.suppress(OSError):
                    file.close()

    def last(self, count: int = limits.LOG_LINES) -> str:
        """The last lines."""
        with self._lines_lock:
            lines = list(self._lines)
        return "\n".join(lines[-count:])


def _remove_old(folder: Path) -> None:
    """Makes room for one log more."""

    def age(path: Path) -> float:
        try:
            return path.stat().st_mtime
        except OSError:  # a link to nothing, or another Blender removed it
            return 0.0

    with contextlib.suppress(OSError):
        for path in sorted(folder.glob("engine-*.log"), key=age, reverse=True)[limits.LOG_FILES - 1 :]:
            with contextlib.suppress(OSError):  # Windows keeps what another Blender has open
                path.unlink()


class EngineProcess:
    """A started engine: its token, its handshake once it has printed one, its end."""

    def __init__(
        self,
        command: Sequence[str],
        log: EngineLog,
        *,
        environment: Mapping[str, str] = os.environ,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        """wake: called from another thread when there is something to look at. JGHandFailure: no_interpreter."""
        try:
            self.popen = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=cleaned_environment(environment),
                creationflags=HIDDEN,
            )
        except OSError as error:
            raise JGHandFailure("no_interpreter", f"{command[0]}: {error.strerror or error}") from error
        self.token = secrets.token_bytes(protocol.TOKEN_BYTES)
        self.handshake: dict[str, Any] | None = None
        self._log, self._wake = log, wake
        pipes = ((self.popen.stdout, True), (self.popen.stderr, False))
        self._drains = [
            threading.Thread(target=self._drain, args=pipe, daemon=True, name="jghand log") for pipe in pipes
        ]
        for drain in self._drains:
            drain.start()
        assert self.popen.stdin is not None  # it was asked for as a pipe
        with contextlib.suppress(OSError):  # it has ended already, which `runs` tells
            self.popen.stdin.write(self.token.hex().encode() + b"\n")
            self.popen.stdin.flush()

    @property
    def runs(self) -> bool:
        """Whether the process has not ended."""
        return self.popen.poll() is None

    def ends_within(self, seconds: float) -> bool:
        """Waits for the end: a connection breaks a little before its process is gone."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.popen.wait(seconds)
        return not self.runs

    def why_it_ended(self) -> tuple[str, str]:
        """Kind and detail of the failure behind the end of the process."""
        for drain in self._drains:  # its last words may still be on their way
            drain.join(limits.LAST_WORDS_S)
        code, words = self.popen.poll(), self._log.last(limits.DETAIL_LINES)
        if self.handshake is None and (missing := _missing(words)):
            return missing
        return kind_of_exit(code or 0), f"exit code {code}"

    def close_stdin(self) -> None:
        """Asks it to end."""
        if self.popen.stdin:
            with contextlib.suppress(OSError):
                self.popen.stdin.close()

    def terminate(self) -> None:
        """Asks it to end, as the system does it."""
        with contextlib.suppress(OSError):
            self.popen.terminate()

    def kill(self) -> bool:
        """Ends it at once; False when it is still there although: one that hangs in the system."""
        with contextlib.suppress(OSError):
            self.popen.kill()
        gone = self.ends_within(limits.KILL_S)
        self.close_stdin()
        return gone

    def _drain(self, pipe: IO[bytes], look_for_handshake: bool) -> None:
        """Keeps a pipe of the engine from filling up; finds the handshake in stdout."""
        with pipe:
            for raw in iter(lambda: pipe.readline(limits.LOG_LINE_MAX), b""):
                line = raw.decode("utf-8", "replace").rstrip()
                found = _handshake(line) if look_for_handshake else None
                if found is not None:
                    look_for_handshake, self.handshake = False, found
                    self._wake()
                elif line:
                    self._log.write(line)
        self._wake()


def _missing(words: str) -> tuple[str, str] | None:
    """Kind and detail of the failure of a Python that has not what it should start, or not all that this needs."""
    if _NO_ENGINE.search(words):
        return "no_engine", ""
    lines = _NO_MODULE.findall(words)
    return ("broken_engine", lines[-1].strip()) if lines else None


def _handshake(line: str) -> dict[str, Any] | None:
    """The handshake that a line is, None for any other line."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and "protocol" in content else None
