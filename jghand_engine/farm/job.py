"""A training as a scheduler runs it: `jghand train` in a process of its own, begun, or gone on with where it stands.

The process is told to stop by the end of its standard input, which also comes when this one is killed: it then writes
its checkpoint. Signals of the scheduler, which reach every process of a job, it does not hear.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from jghand_engine.errors import RetryError
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.trainings import Training
from jghand_engine.limits import CHECKPOINT_WAIT_S, JOB_POLL_S, RECORD_EVERY_S, REQUEUE_WAIT_S
from jghand_engine.training.mark import MARK

PROGRAM = (sys.executable, "-m", "jghand_engine")
STOPPED_CODE = 130
_UNHEARD = [getattr(signal, name) for name in ("SIGTERM", "SIGUSR1", "SIGUSR2") if hasattr(signal, name)]


@dataclass
class TrainingJob:
    """What submitit runs, again after every preemption. out: folder of the list · program: what stands before the
    words of the command."""

    training: Training
    out: Path
    program: tuple[str, ...] = PROGRAM

    def __call__(self) -> str:
        """The sentence of a finished training. RetryError when it was stopped, RuntimeError when it failed: then the
        scheduler calls the job failed."""
        folder = FarmFolder(self.out)
        before = folder.record(self.training.name)
        record = Record(list(self.training.words), State.RUNNING, 1 + (before.starts if before else 0))
        record.host = socket.gethostname()
        folder.write_record(self.training.name, record)
        with _stop_requests() as stop, _running(self._command(folder)) as child:
            self._child = child
            noted_s = time.monotonic()
            while (code := child.poll()) is None:
                if stop.is_set():
                    child.stop()
                if time.monotonic() - noted_s > RECORD_EVERY_S:
                    noted_s, record.progress = time.monotonic(), child.progress
                    folder.write_record(self.training.name, record)
                time.sleep(JOB_POLL_S)
        record.progress, record.told, record.exit_code = child.progress, child.error, code
        record.state = {0: State.FINISHED, STOPPED_CODE: State.STOPPED}.get(code, State.FAILED)
        folder.write_record(self.training.name, record)
        if record.state is State.FINISHED:
            return f"{self.training.name}: {record.progress}"
        if record.state is State.FAILED:
            raise RuntimeError(f"{self.training.name} ended with exit code {code}: {record.told}")
        _wait_for_scheduler()
        raise RetryError(f"the training {self.training.name} was stopped", remedy="The same command goes on with it.")

    def checkpoint(self) -> Any:
        """What submitit asks for when the job is preempted or its time is up, from a signal's handler: the training
        writes its checkpoint; the same job goes on with it when the scheduler begins it again."""
        from submitit.helpers import DelayedSubmission

        child: _Child | None = getattr(self, "_child", None)
        folder = FarmFolder(self.out)
        record = folder.record(self.training.name)
        # neither is there when the signal comes first
        if child is not None and record is not None:
            child.stop()
            child.await_end(CHECKPOINT_WAIT_S)
            record.state, record.progress = State.STOPPED, child.progress
            folder.write_record(self.training.name, record)
        return DelayedSubmission(TrainingJob(self.training, self.out, self.program))

    def _command(self, folder: FarmFolder) -> list[str]:
        name = self.training.name
        begun = (folder.work(name) / MARK).is_file()
        return [
            *self.program, *self.training.words, "--out", str(folder.avatar(name)), "--progress-json",
            *(["--resume"] if begun else []),
        ]  # fmt: skip


@contextlib.contextmanager
def _stop_requests() -> Iterator[threading.Event]:
    """Set by a polite kill or Ctrl-C. Other signals keep submitit's handlers."""
    asked = threading.Event()
    numbers = (signal.SIGTERM, signal.SIGINT)
    before = {number: signal.getsignal(number) for number in numbers}
    for number in numbers:
        if before[number] is not signal.SIG_IGN:
            signal.signal(number, lambda *_: asked.set())
    try:
        yield asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _wait_for_scheduler() -> None:
    """SLURM takes a job back in its own time: one that ended by itself meanwhile would not be begun again."""
    if os.environ.get("SUBMITIT_EXECUTOR") == "slurm":
        time.sleep(REQUEUE_WAIT_S)


class _Child:
    """The process of a training, and what it says."""

    def __init__(self, command: list[str]) -> None:
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
        """Waits for its end. May interrupt `poll`, and so leaves its exit code to that."""
        until_s = time.monotonic() + most_s
        flags = os.WEXITED | os.WNOHANG | os.WNOWAIT
        while time.monotonic() < until_s:
            with contextlib.suppress(ChildProcessError):
                if os.waitid(os.P_PID, self._process.pid, flags) is None:
                    time.sleep(JOB_POLL_S)
                    continue
            return

    def kill(self) -> None:
        self._process.kill()
        self._process.wait()

    def _read(self, stream: IO[str]) -> None:
        for line in stream:
            told = _told(line)
            if told is None:
                sys.stderr.write(line)
            elif told.get("jghand") == "error":
                self.error = str(told.get("text"))
                sys.stderr.write(self.error + "\n")
            elif told.get("jghand") == "note":
                sys.stderr.write(f"{told.get('text')}\n")
            else:
                self.progress = str(told.get("text"))


@contextlib.contextmanager
def _running(command: list[str]) -> Iterator[_Child]:
    """The process; it ends with the block, with its checkpoint whatever ends that."""
    child = _Child(command)
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


def _told(line: str) -> dict[str, Any] | None:
    """One of the lines of --progress-json, None for any other."""
    if line.startswith("{"):
        with contextlib.suppress(ValueError):
            told = json.loads(line)
            if isinstance(told, dict) and "jghand" in told:
                return told
    return None
