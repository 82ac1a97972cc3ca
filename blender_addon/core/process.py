# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine's process and what it prints. Nothing here waits longer than its arguments allow. Does not use bpy.

The engine ends when its stdin does, so it cannot outlive this process, however that ends. Source: BLENDER 3.1 and 3.4.
"""

from __future__ import annotations

import contextlib
import json
import os
import secrets
import subprocess
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from . import limits
from .messages import JGHandFailure
from .wire import protocol

# what Blender's own process would impose on another Python
_DROPPED = ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "LD_LIBRARY_PATH", "LD_PRELOAD", "OCIO")
_DROPPED_PREFIXES = ("DYLD_", "BLENDER_")


def cleaned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment for a Python that is not Blender's."""
    return {
        name: value
        for name, value in environment.items()
        if name not in _DROPPED and not name.startswith(_DROPPED_PREFIXES)
    }


class EngineLog:
    """What the engine printed: the last lines here, all of them in a file where a folder for that is given."""

    def __init__(self, folder: Path | None = None) -> None:
        self._folder = folder
        self._lines: deque[str] = deque(maxlen=limits.LOG_LINES)
        self._lock = threading.Lock()
        self._file: IO[str] | None = None
        self._room = 0
        self.path: Path | None = None

    def begin(self) -> None:
        """A new file for a new process; the oldest files go."""
        self.end()
        if self._folder is None:
            return
        # the process's number keeps two Blenders of the same second apart
        name = f"engine-{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}.log"
        with self._lock, contextlib.suppress(OSError):  # a log that cannot be written is no reason to have no engine
            self._folder.mkdir(parents=True, exist_ok=True)
            old = sorted(self._folder.glob("engine-*.log"), key=lambda path: path.stat().st_mtime, reverse=True)
            for path in old[limits.LOG_FILES - 1 :]:
                with contextlib.suppress(OSError):  # Windows keeps what another Blender has open
                    path.unlink()
            self.path = self._folder / name
            self._file = self.path.open("a", encoding="utf-8", buffering=1)
            self._room = limits.LOG_FILE_MAX_BYTES

    def write(self, line: str) -> None:
        """One line more, from any thread."""
        with self._lock:
            self._lines.append(line)
            if self._file is None or self._room <= 0:
                return
            self._room -= len(line) + 1
            with contextlib.suppress(OSError):  # a full disk
                self._file.write(line + "\n" if self._room > 0 else "… the rest is left out\n")

    def end(self) -> None:
        """Closes the file; the lines stay."""
        with self._lock:
            file, self._file = self._file, None
            if file is not None:
                with contextlib.suppress(OSError):
                    file.close()

    def last(self, count: int = limits.LOG_LINES) -> str:
        """The last lines."""
        with self._lock:
            return "\n".join(list(self._lines)[-count:])


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
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
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
        if "No module named" in words and "jghand_engine" in words:
            return "no_engine", ""
        kinds = {-9: "killed", 137: "killed", 4: "out_of_memory"}
        return kinds.get(code if code is not None else 0, "crashed"), f"exit code {code}"

    def close_stdin(self) -> None:
        """Asks it to end."""
        if self.popen.stdin:
            with contextlib.suppress(OSError):
                self.popen.stdin.close()

    def terminate(self) -> None:
        """Asks it to end, as the system does it."""
        with contextlib.suppress(OSError):
            self.popen.terminate()

    def kill(self) -> None:
        """Ends it at once."""
        with contextlib.suppress(OSError):
            self.popen.kill()
        self.ends_within(limits.TERMINATE_S)
        self.close_stdin()

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


def _handshake(line: str) -> dict[str, Any] | None:
    """The handshake that a line is, None for any other line."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return content if isinstance(content, dict) and "protocol" in content else None
