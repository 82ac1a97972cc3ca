"""Sees a list of trainings through: what is finished stays, what was begun goes on, what is missing is submitted."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from dataclasses import replace

from jghand_engine.errors import InputError, JGHandError, RetryError
from jghand_engine.farm import job
from jghand_engine.farm.executors import Executor
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.signals import held_back
from jghand_engine.farm.trainings import Training
from jghand_engine.limits import SUBMIT_WAIT_S

Tell = Callable[[str, Record], None]


class Runner:
    """The trainings of a list in their folder."""

    def __init__(self, trainings: Sequence[Training], folder: FarmFolder, executor: Executor) -> None:
        self._folder, self._executor = folder, executor
        self._trainings = {training.name: training for training in trainings}
        self.records = {name: self._record(name) for name in self._trainings}
        self._pending = [name for name in self._trainings if not self.is_done(name)]
        self._jobs: dict[str, str] = {}
        self._watched: set[str] = set()
        self._stopping = False

    def is_done(self, name: str) -> bool:
        """Whether the avatar is there, as the list wants it now."""
        return self._folder.is_done(name, self.records[name], self._trainings[name].words)

    def is_of_old_list(self, name: str) -> bool:
        """Whether its job has other options than the list gives now."""
        return name in self._watched and self._is_other(name, self.records[name])

    def submit(self) -> list[str]:
        """Submits what waits, as much as the executor takes; gives the names. RetryError when it refuses."""
        if not self._pending or self._free() == 0:
            return []
        # a job whose number nobody knows would be submitted a second time
        with self._folder.alone(SUBMIT_WAIT_S), held_back():
            self._adopt()
            free = self._free()
            names, self._pending = self._pending[:free], self._pending[free:]
            if not names:
                return []
            for name in names:
                old, training = self.records[name], self._trainings[name]
                self.records[name] = Record(list(training.words), State.WAITING, old.starts, progress=old.progress)
                # before there is a job that could write its own
                self._folder.write_record(name, self.records[name])
            out = self._folder.path.resolve()
            made = {
                name: job.TrainingJob(self._trainings[name], out, job.PROGRAM, job.RECORD_EVERY_S) for name in names
            }
            numbers = self._executor.submit(made)
            self._folder.add_submitted(numbers)
            self._jobs |= numbers
            self._watched.update(names)
        return names

    def run(self, tell: Tell) -> None:
        """Until no training waits or runs. tell: called when the state of one changes, or what it says of itself."""
        while self._pending or self._watched:
            for name in self.submit():
                tell(name, self.records[name])
            self.watch(tell)
            if self._watched:
                time.sleep(self._executor.poll_s)

    def watch(self, tell: Tell) -> None:
        """One look at the trainings whose jobs wait or run."""
        # in this order: a job that ends in between has then written its record
        alive = self._executor.alive([self._jobs[name] for name in self._watched])
        for name in sorted(self._watched):
            before = self.records[name]
            try:
                record = self._record(name)
            except RetryError:
                # a share that does not answer: the next look may see it
                continue
            except InputError as error:
                record = replace(before, told=str(error))
            if self._jobs[name] not in alive:
                self._watched.discard(name)
                self._look_after(name, record)
            self.records[name] = record
            if (before.state, before.progress) != (record.state, record.progress):
                tell(name, record)

    def stop(self, tell: Tell) -> bool:
        """Asks the jobs to end and waits for that; False where they go on without this process."""
        self._pending, self._stopping = [], True
        while self._watched:
            # at each look: a job that is just beginning does not hear it
            if not self._executor.stop():
                return False
            self.watch(tell)
            time.sleep(self._executor.poll_s)
        return True

    def _free(self) -> int:
        most = self._executor.at_once
        return len(self._pending) if most is None else max(0, most - len(self._watched))

    def _adopt(self) -> None:
        """Watches jobs of an earlier command, or of one beside, instead of submitting their trainings again."""
        known = {name: number for name, number in self._folder.submitted().items() if name in self._pending}
        alive = self._executor.alive(list(known.values()))
        known = {name: number for name, number in known.items() if number in alive}
        self._jobs |= known
        self._watched |= known.keys()
        self._pending = [name for name in self._pending if name not in known]

    def _look_after(self, name: str, record: Record) -> None:
        """What becomes of a training whose job is gone."""
        if record.state in (State.WAITING, State.RUNNING):
            record.state = State.STOPPED if self._stopping else State.LOST
            # for people: what is noted there is not what the next command goes by
            with contextlib.suppress(JGHandError):
                self._folder.write_record(name, record)
        elif record.state is State.FINISHED and self._is_other(name, record) and not self._stopping:
            # the list was changed while it ran
            self._pending.append(name)

    def _is_other(self, name: str, record: Record) -> bool:
        return record.words != list(self._trainings[name].words)

    def _record(self, name: str) -> Record:
        return self._folder.record(name) or Record(list(self._trainings[name].words))
