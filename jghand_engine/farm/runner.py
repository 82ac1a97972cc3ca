"""Sees a list of trainings through: what is finished stays, what was begun goes on, what is missing is submitted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from jghand_engine.errors import JGHandError, RetryError
from jghand_engine.farm.executors import Executor
from jghand_engine.farm.job import TrainingJob
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.signals import held_back
from jghand_engine.farm.trainings import Training
from jghand_engine.limits import SUBMIT_WAIT_S
from jghand_engine.lock import locked

Tell = Callable[[str, Record], None]


class Runner:
    """The trainings of a list in their folder. records: what is known of each; those on the disk are of its jobs ·
    watched: those whose jobs wait or run"""

    def __init__(
        self, trainings: Sequence[Training], folder: FarmFolder, executor: Executor,
        warn: Callable[[str], None] = lambda _: None,
    ) -> None:  # fmt: skip
        """warn: told what hinders it for now, each sentence once"""
        self._folder, self._executor, self._warn = folder, executor, warn
        self._trainings = {training.name: training for training in trainings}
        self.records = {name: self._record(name) for name in self._trainings}
        self._pending = [name for name in self._trainings if not self.is_done(name)]
        self._jobs: dict[str, str] = {}
        self.watched: set[str] = set()
        self._stopping = False

    def is_done(self, name: str) -> bool:
        """Whether the avatar is there, as the list wants it now."""
        return self._folder.is_done(name, self.records[name], self._trainings[name].words)

    def is_changed(self, name: str) -> bool:
        """Whether its job had other options than the list gives now."""
        return not self.records[name].is_of(self._trainings[name].words)

    def submit(self) -> list[str]:
        """Submits what waits, as much as the executor takes; gives the names. RetryError when it refuses."""
        if not self._pending or self._free() == 0:
            return []
        # a job whose number nobody knows would be submitted a second time
        with self._folder.alone(SUBMIT_WAIT_S), held_back():
            self._adopt()
            names = self._begin(self._free())
            if names:
                out = self._folder.path.resolve()
                numbers = self._executor.submit({name: TrainingJob(self._trainings[name], out) for name in names})
                if self._executor.outlived:
                    self._folder.add_submitted(numbers)
                self._watch(numbers)
        return names

    def run(self, tell: Tell) -> None:
        """Until no training waits or runs. tell: called when the state of one changes, or what it says of itself."""
        warned: set[str] = set()
        while self._pending or self.watched:
            try:
                # first, as nothing that is refused to the next ones is to keep it from those that run
                self.watch(tell)
                for name in self.submit():
                    tell(name, self.records[name])
            except RetryError as error:
                if not self.watched:
                    raise
                if str(error) not in warned:
                    warned.add(str(error))
                    self._warn(str(error))
            if self.watched:
                time.sleep(self._executor.poll_s)

    def watch(self, tell: Tell) -> None:
        """One look at the trainings whose jobs wait or run. RetryError where the scheduler does not answer."""
        if not self.watched:
            return
        if self._executor.outlived:
            # somebody may have submitted one again
            submitted = self._folder.submitted()
            self._jobs |= {name: submitted[name] for name in self.watched & submitted.keys()}
        # before the records: a job that ends in between has then written its own
        alive = self._executor.alive([self._jobs[name] for name in self.watched])
        for name in sorted(self.watched):
            before = self.records[name]
            try:
                record = self._record(name)
            except JGHandError as error:
                # a share that does not answer may do so at the next look
                record = replace(before, told=str(error))
            if self._jobs[name] not in alive:
                self.watched.discard(name)
                if record.state in (State.WAITING, State.RUNNING):
                    record.state = State.STOPPED if self._stopping else State.LOST
            self.records[name] = record
            if (before.state, before.progress) != (record.state, record.progress):
                tell(name, record)

    def stop(self, tell: Tell) -> None:
        """Asks the jobs to end and waits for that; submits no more, and nothing else where they outlive it."""
        self._pending, self._stopping = [], True
        while self.watched and not self._executor.outlived:
            # at each look: a job that is just beginning does not hear it
            self._executor.stop()
            self.watch(tell)
            time.sleep(self._executor.poll_s)

    def _free(self) -> int:
        most = self._executor.at_once
        return len(self._pending) if most is None else max(0, most - len(self.watched))

    def _adopt(self) -> None:
        """Watches jobs of an earlier command, or of one beside, instead of submitting their trainings again."""
        if self._executor.outlived:
            known = {name: number for name, number in self._folder.submitted().items() if name in self._pending}
            alive = self._executor.alive(list(known.values()))
            self._watch({name: number for name, number in known.items() if number in alive})

    def _watch(self, numbers: dict[str, str]) -> None:
        self._jobs |= numbers
        self.watched |= numbers.keys()
        self._pending = [name for name in self._pending if name not in numbers]

    def _begin(self, most: int) -> list[str]:
        """The next of those that nobody has finished meanwhile; they are noted to wait."""
        names: list[str] = []
        for name in list(self._pending):
            if len(names) == most:
                break
            self._note_waiting(name)
            if self.is_done(name):
                self._pending.remove(name)
            else:
                names.append(name)
        return names

    def _note_waiting(self, name: str) -> None:
        try:
            with locked(self._folder.lock(name)):
                before = self.records[name] = self._record(name)
                if not self.is_done(name):
                    words = list(self._trainings[name].words)
                    self.records[name] = Record(words, State.WAITING, before.starts, progress=before.progress)
                    self._folder.write_record(name, self.records[name])
        except RetryError:
            # the job that holds it writes its own; on a full disk it is written by the one that begins
            self.records[name] = self._record(name)

    def _record(self, name: str) -> Record:
        return self._folder.record(name) or Record(list(self._trainings[name].words))
