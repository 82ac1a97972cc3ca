"""A training as a scheduler runs it: `jghand train` in a process of its own, begun, or gone on with where it stands."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NoReturn

from jghand_engine.errors import JGHandError, RetryError
from jghand_engine.farm.child import Child, running
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.signals import stop_requests
from jghand_engine.farm.trainings import Training
from jghand_engine.limits import CHECKPOINT_WAIT_S, JOB_POLL_S, RECORD_EVERY_S, RECORD_WAIT_S, REQUEUE_WAIT_S
from jghand_engine.lock import locked
from jghand_engine.training.mark import LOCK, MARK

PROGRAM = (sys.executable, "-m", "jghand_engine")
STOPPED_CODE = 130


@dataclass
class TrainingJob:
    """What submitit runs, again after every preemption. out: folder of the list · program: what stands before the
    words of the command · note_every_s: between two notes of how far it is"""

    training: Training
    out: Path
    program: tuple[str, ...] = PROGRAM
    note_every_s: float = RECORD_EVERY_S
    _child: Child | None = field(default=None, init=False, repr=False, compare=False)

    def __call__(self) -> str:
        """The sentence of a finished training. RetryError when it was stopped, RuntimeError when it failed: then the
        scheduler calls the job failed."""
        folder, name = FarmFolder(self.out), self.training.name
        with stop_requests() as stop, self._alone(folder, stop):
            # a job that outlived the command which began it may have come first
            record = self._record(folder)
            if record is None or not folder.is_done(name, record, self.training.words):
                record = self._train(folder, record, stop)
        if record.state is State.FINISHED:
            return f"{name}: {record.progress}"
        if record.state is State.FAILED:
            raise RuntimeError(f"{name} ended with exit code {record.exit_code}: {record.told}")
        self._was_stopped()

    def checkpoint(self) -> Any:
        """What submitit asks for when the job is preempted or its time is up, from a signal's handler: the training
        writes its checkpoint; the same job goes on with it when the scheduler begins it again."""
        from submitit.helpers import DelayedSubmission

        folder = FarmFolder(self.out)
        # not there when the signal comes first
        if (child := self._child) is not None:
            child.stop()
            child.await_end(CHECKPOINT_WAIT_S)
            if (record := self._record(folder)) is not None:
                record.state, record.progress = State.STOPPED, child.progress
                self._note(folder, record)
        return DelayedSubmission(replace(self))

    # ---- one start ---------------------------------------------------------------------------------------------------

    def _train(self, folder: FarmFolder, before: Record | None, stop: threading.Event) -> Record:
        """Runs the training to its end or to a stop; gives the record of that, which it has written."""
        record = Record(list(self.training.words), State.RUNNING, 1 + (before.starts if before else 0))
        record.host = socket.gethostname()
        self._note(folder, record)
        with running(self._command(folder)) as child:
            self._child = child
            noted_s = time.monotonic()
            while (code := child.poll()) is None:
                if stop.is_set():
                    child.stop()
                if time.monotonic() - noted_s > self.note_every_s:
                    noted_s, record.progress = time.monotonic(), child.progress
                    self._note(folder, record)
                time.sleep(JOB_POLL_S)
        record.progress, record.told, record.exit_code = child.progress, child.error, code
        record.state = {0: State.FINISHED, STOPPED_CODE: State.STOPPED}.get(code, State.FAILED)
        self._note(folder, record, most_s=RECORD_WAIT_S)
        return record

    def _command(self, folder: FarmFolder) -> list[str]:
        name = self.training.name
        begun = (folder.work(name) / MARK).is_file()
        return [
            *self.program, *self.training.words, "--out", str(folder.avatar(name)), "--progress-json",
            *(["--resume"] if begun else []),
        ]  # fmt: skip

    # ---- who else is there -------------------------------------------------------------------------------------------

    @contextlib.contextmanager
    def _alone(self, folder: FarmFolder, stop: threading.Event) -> Iterator[None]:
        """Waits until no other job is at this training, nor a training whose job was killed, which writes its
        checkpoint; then keeps others out. RetryError when it is to stop before."""
        name = self.training.name
        with self._awaited(folder.lock(name), stop):
            if (training := folder.work(name) / LOCK).is_file():
                with self._awaited(training, stop):
                    pass
            yield

    @contextlib.contextmanager
    def _awaited(self, path: Path, stop: threading.Event) -> Iterator[None]:
        """Holds the lock, as soon as it is free."""
        said = False
        with contextlib.ExitStack() as held:
            while not stop.is_set():
                try:
                    held.enter_context(locked(path, work="training", remedy="Waiting for its end."))
                    break
                except RetryError as error:
                    if not said:
                        print(error, file=sys.stderr, flush=True)
                    said = True
                    time.sleep(JOB_POLL_S)
            else:
                self._was_stopped()
            yield

    def _was_stopped(self) -> NoReturn:
        # SLURM takes a job back in its own time: one that ended by itself meanwhile would not be begun again
        if os.environ.get("SUBMITIT_EXECUTOR") == "slurm":
            time.sleep(REQUEUE_WAIT_S)
        raise RetryError(f"the training {self.training.name} was stopped", remedy="The same command goes on with it.")

    # ---- notes -------------------------------------------------------------------------------------------------------

    def _record(self, folder: FarmFolder) -> Record | None:
        """What is noted of the training; None too where it cannot be read, which is no reason not to train."""
        with contextlib.suppress(JGHandError):
            return folder.record(self.training.name)
        return None

    def _note(self, folder: FarmFolder, record: Record, most_s: float = 0.0) -> None:
        """Writes the record; tried again for so long. What cannot be written is no reason to end a training."""
        until_s = time.monotonic() + most_s
        while True:
            try:
                return folder.write_record(self.training.name, record)
            except JGHandError:
                if time.monotonic() >= until_s:
                    return None
                time.sleep(self.note_every_s)
