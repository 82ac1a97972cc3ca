"""The process of a training.

It is told to stop by the end of its standard input, which also comes when this process is killed: it then writes its
checkpoint. Signals of the scheduler, which reach every process of a job, it does not hear.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from typing import IO, Any

from jghand_engine.limits import CHECKPOINT_WAIT_S

_UNHEARD = [getattr(signal, name) for name in ("SIGHUP", "SIGTERM", "SIGUSR1", "SIGUSR2") if hasattr(signal, name)]


class Child:
    """Runs `command`. progress, error: what it said last of each"""

    def __init__(self, command: Sequence[str]) -> None:
        self.progress = self.error = ""
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8", errors="replace",
            start_new_session=True, preexec_fn=_hear_nothing,
        )  # fmt: skip
        self._reader = threading.Thread(target=self._read, args=(self._process.stderr,), daemon=True)
        self._reader.start()

    def poll(self) -> int | None:
        """The exit code, None while it runs."""
        code = self._process.poll()
        if code is not None:
            self._reader.join()
        return code

    def stop(self) -> None:
        """Asks it to write its checkpoint and end."""
        if self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def await_end(self, most_s: float) -> None:
        """Waits for its end, which is that of its standard error too. May interrupt `poll`, and so leaves its exit code
        to that."""
        self._reader.join(most_s)

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _read(self, stream: IO[str]) -> None:
        for line in stream:
            told = _told(line)
            if told is None:
                _log(line)
            elif told.get("jghand") == "error":
                self.error = str(told.get("text"))
                _log(self.error + "\n")
            elif told.get("jghand") == "note":
                _log(f"{told.get('text')}\n")
            else:
                self.progress = str(told.get("text"))


@contextlib.contextmanager
def running(command: Sequence[str]) -> Iterator[Child]:
    """The process; it ends with the block, with its checkpoint whatever ends that."""
    child = Child(command)
    try:
        yield child
    finally:
        child.stop()
        child.await_end(CHECKPOINT_WAIT_S)
        if child.poll() is None:
            child.kill()


def _hear_nothing() -> None:
    for number in _UNHEARD:
        signal.signal(number, signal.SIG_IGN)
    # a local job is begun with it blocked; the end of its input is Ctrl-C to a training
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


def _log(text: str) -> None:
    # on a full disk too the training must be read, or it waits for ever to be
    with contextlib.suppress(OSError, ValueError):
        sys.stderr.write(text)


def _told(line: str) -> dict[str, Any] | None:
    """One of the lines of --progress-json, None for any other."""
    if line.startswith("{"):
        with contextlib.suppress(ValueError):
            told = json.loads(line)
            if isinstance(told, dict) and "jghand" in told:
                return told
    return None
