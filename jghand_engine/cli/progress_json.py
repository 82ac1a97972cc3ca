"""Commands that another program started: progress as lines of JSON, and an end of their input that means Ctrl-C.

With --progress-json every line of standard error that begins with `{` is one object whose key `jghand` says what it is:

    {"jghand": "progress", "text": "Writing USD", "done": 3, "total": 12, "eta_s": 1.5}   eta_s: null while unknown
    {"jghand": "training", "text": "step 40 of 900 · …", "done": 40, "total": 900, "eta_s": 3100.0}
    {"jghand": "note", "text": "Resuming at step 40."}
    {"jghand": "error", "kind": "retry", "text": "…", "exit_code": 3}

Results stay on standard output. The end of standard input stops the command as Ctrl-C does, on every system and also
when the program that started it was killed: a training then writes its checkpoint.
"""

from __future__ import annotations

import _thread
import contextlib
import errno
import json
import math
import os
import signal
import sys
import threading
import time
from collections.abc import Iterator
from typing import IO, TYPE_CHECKING, Any

from jghand_engine.cli.failures import FAULT, STOPPED, Failure
from jghand_engine.errors import DiskFullError

if TYPE_CHECKING:
    from jghand_engine.learn.progress import Status

# the option, which every verb takes, wherever it stands
PROGRESS_JSON = "--progress-json"
# seconds between two lines of progress: a panel is not read faster, and a pipe is not flooded
PROGRESS_JSON_S = 0.25
# seconds after the end of standard input until such a command ends regardless: a step of a training and its checkpoint
# take a few, a picture of a capture up to a minute
STOP_WITHOUT_INPUT_S = 90.0
_FULL = (errno.ENOSPC, errno.EDQUOT)
# what an exit code is called, as in the replies of the service
_KINDS = {FAULT: "internal", 2: "bad_input", 3: "retry", 4: "out_of_memory", STOPPED: "canceled"}


class JsonLines:
    """Writes the lines. Progress is at most one line every PROGRESS_JSON_S, but its first and its last always."""

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream
        self._lock = threading.Lock()
        self._last_s = -math.inf

    def progress(self, text: str, done: float, total: float, eta_s: float | None, *, kind: str = "progress") -> None:
        now_s = time.monotonic()
        if now_s - self._last_s < PROGRESS_JSON_S and 0 < done < total:
            return
        self._last_s = now_s
        eta = None if eta_s is None or not math.isfinite(eta_s) else round(eta_s, 1)
        self._write(jghand=kind, text=text, done=done, total=total, eta_s=eta)

    def note(self, text: str) -> None:
        self._write(jghand="note", text=text)

    def error(self, failure: Failure, error: BaseException) -> None:
        full = isinstance(error, DiskFullError) or (isinstance(error, OSError) and error.errno in _FULL)
        kind = "disk_full" if full else _KINDS.get(failure.exit_code, "internal")
        self._write(jghand="error", kind=kind, text=failure.sentence, exit_code=failure.exit_code)

    def _write(self, **content: Any) -> None:
        # whoever read along may be gone; a training still has its checkpoint to write
        with self._lock, contextlib.suppress(OSError, ValueError):
            self._stream.write(json.dumps(content) + "\n")
            self._stream.flush()


_lines: JsonLines | None = None


def json_lines() -> JsonLines | None:
    """The lines of this process, None where people read along."""
    return _lines


@contextlib.contextmanager
def started_by_a_program(lines: JsonLines | None) -> Iterator[None]:
    """While it lasts, progress goes out as these lines, and the end of standard input is Ctrl-C. Nothing for None."""
    global _lines
    if lines is None:
        yield
        return
    from jghand_engine.service import server

    # whoever starts children in the background may have told them to ignore it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    # what is printed may have every letter: on Windows a pipe takes those of one old code page alone, and any other
    # would end the command
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(encoding="utf-8", errors="replace")
    _lines = lines
    begun = threading.Event()
    try:
        with contextlib.suppress(OSError):  # there may be no standard input
            told = (lines, server.take_stdin(), begun)
            threading.Thread(target=_await_end_of_input, args=told, daemon=True, name="jghand stdin").start()
        begun.set()
        yield
    finally:
        _lines = None


def _await_end_of_input(of: JsonLines, stdin: int, begun: threading.Event) -> None:
    # an interrupt of a thread's start leaves it half started
    begun.wait()
    try:
        # not sys.stdin: a daemon thread that holds its lock at the end of the process would abort it
        while os.read(stdin, 4096):
            pass
    except OSError:
        return
    if _lines is not of:
        return
    main = threading.main_thread().ident
    # nobody is left who could end a command that does not listen
    watchdog = threading.Timer(STOP_WITHOUT_INPUT_S, os._exit, (STOPPED,))
    watchdog.daemon = True
    watchdog.start()
    if hasattr(signal, "pthread_kill") and main is not None:
        # a signal wakes the main thread from whatever it waits for
        signal.pthread_kill(main, signal.SIGINT)
    else:
        _thread.interrupt_main()


class JsonTraining:
    """Where a training says how it goes (`learn.progress.Display`), in lines."""

    def __init__(self, lines: JsonLines) -> None:
        self._lines = lines

    def update(self, status: Status) -> None:
        self._lines.progress(status.sentence(), status.step, status.steps, status.seconds_left, kind="training")

    def note(self, sentence: str) -> None:
        self._lines.note(sentence)
