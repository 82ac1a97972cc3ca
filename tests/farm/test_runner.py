"""Lists seen through by a scheduler that is none: what is submitted, watched, and called done."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

import pytest

from jghand_engine.errors import InputError, RetryError
from jghand_engine.farm import records, runner
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.runner import Runner
from jghand_engine.farm.trainings import Training


class Scheduler:
    """Numbers its jobs, which live until they are taken out of `living`. meanwhile: called while it submits, and at
    each look"""

    poll_s = 0.0

    def __init__(self, at_once: int | None = None) -> None:
        self.at_once = at_once
        self.living: set[str] = set()
        self.given: list[tuple[str, ...]] = []
        self.meanwhile: Callable[[], None] = lambda: None
        self.stops = 0

    def submit(self, jobs):
        self.meanwhile()
        self.given.append(tuple(jobs))
        numbers = {name: f"{len(self.given)}_{index}" for index, name in enumerate(jobs)}
        self.living |= set(numbers.values())
        return numbers

    def alive(self, numbers):
        self.meanwhile()
        return set(numbers) & self.living

    def stop(self):
        self.stops += 1
        return True


@pytest.fixture
def folder(tmp_path) -> FarmFolder:
    made = FarmFolder(tmp_path)
    made.make()
    return made


def training(name: str, steps: int = 100) -> Training:
    return Training(name, ("train", "/pictures", "--steps", str(steps)))


def ends(folder: FarmFolder, scheduler: Scheduler, of: Training, state: State = State.FINISHED) -> None:
    """What the job of a training leaves when it ends."""
    folder.write_record(of.name, Record(list(of.words), state, 1, 0))
    folder.avatar(of.name).touch()
    scheduler.living.clear()


def test_lists_share_a_folder_and_no_job_is_submitted_twice(folder):
    scheduler = Scheduler()
    for name in ("a", "b", "a", "b"):
        Runner([training(name)], folder, scheduler).submit()
    assert scheduler.given == [("a",), ("b",)]
    assert folder.submitted() == {"a": "1_0", "b": "2_0"}


def test_two_commands_that_begin_together_submit_once(folder):
    scheduler = Scheduler()
    both = [Runner([training("a")], folder, scheduler) for _ in range(2)]
    for one in both:
        one.submit()
    assert scheduler.given == [("a",)]


def test_a_list_that_is_changed_while_it_runs_is_trained_as_it_is_now(folder):
    scheduler = Scheduler()
    Runner([training("a", 100)], folder, scheduler).submit()
    changed = Runner([training("a", 9999)], folder, scheduler)
    changed.submit()
    assert changed.is_of_old_list("a")
    looks = iter([lambda: ends(folder, scheduler, training("a", 100)), lambda: None, lambda: None,
                  lambda: ends(folder, scheduler, training("a", 9999))])  # fmt: skip
    scheduler.meanwhile = lambda: next(looks, lambda: None)()
    changed.run(lambda *_: None)
    assert scheduler.given == [("a",), ("a",)]
    assert changed.is_done("a")


def test_a_signal_while_jobs_are_submitted_does_not_lose_their_numbers(folder):
    scheduler = Scheduler()
    scheduler.meanwhile = lambda: os.kill(os.getpid(), signal.SIGINT)
    asked = Runner([training("a")], folder, scheduler)
    with pytest.raises(KeyboardInterrupt):
        asked.submit()
    assert folder.submitted() == {"a": "1_0"}
    scheduler.meanwhile = lambda: None
    Runner([training("a")], folder, scheduler).submit()
    assert scheduler.given == [("a",)]


def test_no_name_stands_in_the_way_of_the_files_of_the_list(folder):
    names = ("submitted", "records", "logs", "lock", ".lock", "jobs")
    scheduler = Scheduler()
    for _ in range(2):
        Runner([training(name) for name in names], folder, scheduler).submit()
    assert scheduler.given == [names]


def test_a_job_that_is_gone_without_a_word_is_lost(folder):
    scheduler = Scheduler()
    asked = Runner([training("a")], folder, scheduler)
    asked.submit()
    scheduler.living.clear()
    asked.run(lambda *_: None)
    assert asked.records["a"].state is State.LOST


def test_a_record_that_cannot_be_read_for_a_while_ends_nothing(folder, monkeypatch):
    scheduler, found = Scheduler(), FarmFolder.record
    asked = Runner([training("a")], folder, scheduler)
    asked.submit()
    answers = iter([RetryError("stale"), RetryError("stale")])

    def stale(self, name):
        if error := next(answers, None):
            raise error
        return found(self, name)

    ends(folder, scheduler, training("a"))
    monkeypatch.setattr(FarmFolder, "record", stale)
    asked.run(lambda *_: None)
    assert asked.is_done("a")


@pytest.mark.parametrize("content", ["{}", "[", '{"state": "bogus"}'])
def test_a_damaged_record_ends_no_other_training(folder, content):
    scheduler = Scheduler()
    asked = Runner([training("a"), training("b")], folder, scheduler)
    asked.submit()
    ends(folder, scheduler, training("b"))
    (folder.jobs / "records" / "a.json").write_text(content)
    asked.run(lambda *_: None)
    assert asked.is_done("b")
    assert asked.records["a"].state is State.LOST
    assert "wanted" in asked.records["a"].told


def test_a_damaged_record_is_refused_at_the_start_with_what_to_do(folder):
    record = Record([], State.FINISHED, 1)
    folder.write_record("a", record)
    path = folder.jobs / "records" / "a.json"
    path.write_text(path.read_text().replace("finished", "bogus"))
    with pytest.raises(InputError, match=r"record of a training.*Remove it"):
        Runner([training("a")], folder, Scheduler())


def test_jobs_that_do_not_hear_it_are_asked_again_to_stop(folder):
    scheduler = Scheduler(at_once=1)
    asked = Runner([training("a"), training("b")], folder, scheduler)
    asked.submit()
    scheduler.meanwhile = lambda: scheduler.living.clear() if scheduler.stops == 3 else None
    assert asked.stop(lambda *_: None)
    assert scheduler.stops == 3
    assert asked.records["a"].state is State.STOPPED
    assert scheduler.given == [("a",)]


def test_a_folder_in_which_another_command_submits_for_long_is_refused(folder, monkeypatch):
    monkeypatch.setattr(records, "SUBMIT_POLL_S", 0.01)
    monkeypatch.setattr(runner, "SUBMIT_WAIT_S", 0.05)
    with FarmFolder(folder.path).alone(), pytest.raises(RetryError, match="no other jghand train-many"):
        Runner([training("a")], folder, Scheduler()).submit()
    assert folder.record("a") is None
