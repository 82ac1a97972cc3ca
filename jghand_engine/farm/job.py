"""A training as a scheduler runs it: `jghand train` in a process of its own, begun, or gone on with where it stands."""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import threading
import time
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

from jghand_engine.errors import STOPPED, JGHandError, RetryError
from jghand_engine.farm.child import Child, running
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.signals import stop_requests
from jghand_engine.farm.trainings import Training
from jghand_engine.learn.mark import LOCK, MARK
from jghand_engine.limits import CHECKPOINT_WAIT_S, JOB_POLL_S, RECORD_EVERY_S, RECORD_WAIT_S, REQUEUE_WAIT_S
from jghand_engine.lock import locked

PROGRAM = (sys.executable, "-m", "jghand_engine")


@dataclass
class TrainingJob:
    """What submitit runs, again after every preemption. out: folder of the list · program: what stands before the
    words of the command · note_every_s: between two notes of how far it is"""

    training: Training
    out: Path
    program: tuple[str, ...] = field(default_factory=lambda: PROGRAM)
    note_every_s: float = field(default_factory=lambda: RECORD_EVERY_S)
    _child: Child | None = field(default=None, init=False, repr=False, compare=False)

    def __call__(self) -> str:
        """The sentence of a finished training. RetryError when it was stopped, RuntimeError when it failed: then the
        scheduler calls the job failed."""
        name = self.training.name
        with stop_requests() as stop:
            try:
                record = self._seen_through(FarmFolder(self.out), stop)
            except RetryError:
                if not stop.is_set():
                    raise
                record = None
        if record is not None and record.state is State.FINISHED:
            return f"{name}: {record.progress}"
        if record is not None and record.state is State.FAILED:
            raise RuntimeError(f"{name} ended with exit code {record.exit_code}: {record.told}")
        # SLURM takes a job back in its own time: one that ended by itself meanwhile would not be begun again
        if os.environ.get("SUBMITIT_EXECUTOR") == "slurm":
            time.sleep(REQUEUE_WAIT_S)
        raise RetryError(f"the training {name} was stopped", remedy="The same command goes on with it.")

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

    def _seen_through(self, folder: FarmFolder, stop: threading.Event) -> Record:
        """Waits until no other job is at this training, nor a training whose job was killed, which writes its
        checkpoint; then keeps others out and trains. RetryError when it is to stop before."""
        name = self.training.name
        told: list[RetryError] = []

        def waits(held: RetryError) -> bool:
            if not told:
                print(held, file=sys.stderr, flush=True)
                told.append(held)
            return not stop.is_set()

        alone = partial(locked, work="training", remedy="Waiting for its end.", waits=waits)
        with alone(folder.lock(name)):
            if (training := folder.work(name) / LOCK).is_file():
                with alone(training):
                    pass
            # the other may have done it
            record = self._record(folder)
            if record is None or not folder.is_done(name, record, self.training.words):
                record = self._train(folder, record, stop)
            return record

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
        record.state = {0: State.FINISHED, STOPPED: State.STOPPED}.get(code, State.FAILED)
        self._note(folder, record, most_s=RECORD_WAIT_S)
        return record

    def _command(self, folder: FarmFolder) -> list[str]:
        name = self.training.name
        begun = (folder.work(name) / MARK).is_file()
        return [
            *self.program, *self.training.words, "--out", str(folder.avatar(name)), "--progress-json",
            *(["--resume"] if begun else []),
        ]  # fmt: skip

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
