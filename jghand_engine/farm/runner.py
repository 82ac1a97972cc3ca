"""Sees a list of trainings through: what is finished stays, what was begun goes on, what is missing is submitted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence

from jghand_engine.farm import job
from jghand_engine.farm.executors import Executor
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.trainings import Training

Tell = Callable[[str, Record], None]


class Runner:
    """The trainings of a list in their folder."""

    def __init__(self, trainings: Sequence[Training], folder: FarmFolder, executor: Executor) -> None:
        self._folder, self._executor = folder, executor
        self._trainings = {training.name: training for training in trainings}
        self.records = {name: self._record(name) for name in self._trainings}
        self._jobs = {name: number for name, number in folder.submitted().items() if name in self._trainings}
        alive = executor.alive(list(self._jobs.values()))
        self._watched = {name for name, number in self._jobs.items() if number in alive}
        self._pending = [name for name in self._trainings if name not in self._watched and not self.is_done(name)]

    def is_done(self, name: str) -> bool:
        """Whether the avatar is there, as the list wants it now."""
        record = self.records[name]
        asked = list(self._trainings[name].words)
        return record.state is State.FINISHED and record.words == asked and self._folder.avatar(name).is_file()

    def submit(self) -> list[str]:
        """Submits what waits, as much as the executor takes; gives the names. RetryError when it refuses."""
        most = self._executor.at_once
        free = len(self._pending) if most is None else max(0, most - len(self._watched))
        names, self._pending = self._pending[:free], self._pending[free:]
        if not names:
            return []
        for name in names:
            old, training = self.records[name], self._trainings[name]
            self.records[name] = Record(list(training.words), State.WAITING, old.starts, progress=old.progress)
            # before there is a job that could write its own
            self._folder.write_record(name, self.records[name])
        out = self._folder.path.resolve()
        made = {name: job.TrainingJob(self._trainings[name], out, job.PROGRAM) for name in names}
        self._jobs |= self._executor.submit(made)
        self._folder.write_submitted(self._jobs)
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
            before, record = self.records[name], self._record(name)
            if self._jobs[name] not in alive:
                self._watched.discard(name)
                if record.state in (State.WAITING, State.RUNNING):
                    record.state = State.LOST
                    self._folder.write_record(name, record)
            self.records[name] = record
            if (before.state, before.progress) != (record.state, record.progress):
                tell(name, record)

    def stop(self, tell: Tell) -> bool:
        """Asks the jobs to end and waits for that; False where they go on without this process."""
        self._pending = []
        if not self._executor.stop():
            return False
        self.run(tell)
        return True

    def _record(self, name: str) -> Record:
        return self._folder.record(name) or Record(list(self._trainings[name].words))
