"""Lists seen through by a scheduler that is none: what is submitted, watched, and called done."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable

import pytest

from jghand_engine import lock
from jghand_engine.cli.train_many import _exit_code
from jghand_engine.errors import InputError, RetryError
from jghand_engine.farm import runner
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.runner import Runner
from jghand_engine.farm.trainings import Training
from jghand_engine.lock import locked


class Scheduler:
    """Numbers its jobs, which live until they are taken out of `living`. meanwhile: called while it submits, and at
    each look"""

    poll_s = 0.0

    def __init__(self, at_once: int | None = None, outlived: bool = True) -> None:
        self.at_once, self.outlived = at_once, outlived
        self.living: set[str] = set()
        self.given: list[tuple[str, ...]] = []
        self.meanwhile: Callable[[], None] = lambda: None
        self.stops = self.looks = 0

    def submit(self, jobs):
        self.meanwhile()
        self.given.append(tuple(jobs))
        numbers = {name: f"{len(self.given)}_{index}" for index, name in enumerate(jobs)}
        self.living |= set(numbers.values())
        return numbers

    def alive(self, numbers):
        self.looks += 1
        assert self.looks < 100, f"nobody ends {self.living}"
        self.meanwhile()
        return set(numbers) & self.living

    def stop(self):
        self.stops += 1


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


def test_two_commands_that_begin_together_submit_once(folder, monkeypatch):
    monkeypatch.setattr(runner, "SUBMIT_WAIT_S", 0.0)
    scheduler = Scheduler()
    one, two = (Runner([training("a")], FarmFolder(folder.path), scheduler) for _ in range(2))
    refused = []

    def begin_the_second() -> None:
        scheduler.meanwhile = lambda: None
        with pytest.raises(RetryError, match="no other jghand train-many"):
            two.submit()
        refused.append(two)

    scheduler.meanwhile = begin_the_second
    one.submit()
    assert refused == [two]
    two.submit()
    assert scheduler.given == [("a",)]


def test_a_training_that_ended_while_others_ran_is_not_begun_again(folder):
    scheduler = Scheduler(at_once=1, outlived=False)
    asked = Runner([training("a"), training("b")], folder, scheduler)
    asked.submit()
    # by a job that outlived an earlier command
    ends(folder, scheduler, training("b"))
    ends(folder, scheduler, training("a"))
    asked.run(lambda *_: None)
    assert scheduler.given == [("a",)]
    assert asked.is_done("b")


def test_the_record_of_a_training_that_a_job_is_at_is_left_to_it(folder):
    running = Record(list(training("a").words), State.RUNNING, 2, progress="half")
    folder.write_record("a", running)
    scheduler = Scheduler(outlived=False)
    with locked(folder.lock("a")):
        Runner([training("a")], folder, scheduler).submit()
    assert scheduler.given == [("a",)]
    assert folder.record("a") == running


def test_a_training_that_was_submitted_again_is_not_lost_to_who_watched_its_first_job(folder):
    scheduler = Scheduler()
    one, two = (Runner([training("a")], folder, scheduler) for _ in range(2))
    one.submit()
    two.submit()
    scheduler.living.clear()
    one.watch(lambda *_: None)
    assert one.records["a"].state is State.LOST
    Runner([training("a")], folder, scheduler).submit()
    running = Record(list(training("a").words), State.RUNNING, 2)
    folder.write_record("a", running)
    two.watch(lambda *_: None)
    assert folder.record("a") == running == two.records["a"]
    assert two.watched


def test_numbers_of_local_jobs_are_not_taken_for_those_of_a_cluster(folder):
    local, cluster = Scheduler(outlived=False), Scheduler()
    Runner([training("a")], folder, local).submit()
    # another job that has the same one
    cluster.living = set(local.living)
    Runner([training("a")], folder, cluster).submit()
    assert cluster.given == [("a",)]


def test_a_list_that_is_changed_while_its_jobs_run_is_told_of(folder):
    scheduler = Scheduler()
    Runner([training("a", 100)], folder, scheduler).submit()
    changed = Runner([training("a", 9999)], folder, scheduler)
    changed.submit()
    ends(folder, scheduler, training("a", 100))
    changed.run(lambda *_: None)
    assert scheduler.given == [("a",)]
    assert changed.is_changed("a")
    assert _exit_code(changed, "a") == 3
    again = Runner([training("a", 9999)], folder, scheduler)
    again.submit()
    assert scheduler.given == [("a",), ("a",)]
    assert not again.is_changed("a")


def test_pictures_that_were_moved_are_the_same_training(folder):
    words = ("train", "/mnt/other/pictures", *training("a").words[2:])
    ends(folder, Scheduler(), training("a"))
    assert Runner([Training("a", words)], folder, Scheduler()).is_done("a")


def test_a_cluster_that_does_not_answer_is_told_once_and_then_asked_again(folder):
    scheduler, warned = Scheduler(), []
    asked = Runner([training("a")], folder, scheduler, warned.append)
    asked.submit()
    looks = iter([silent, silent, lambda: ends(folder, scheduler, training("a"))])
    scheduler.meanwhile = lambda: next(looks, lambda: None)()
    asked.run(lambda *_: None)
    assert asked.is_done("a")
    assert warned == ["the cluster does not answer."]


def test_while_a_cluster_does_not_answer_nothing_is_submitted(folder):
    scheduler = Scheduler()
    Runner([training("a")], folder, scheduler).submit()
    scheduler.meanwhile = silent
    with pytest.raises(RetryError, match="does not answer"):
        Runner([training("a")], folder, scheduler).run(lambda *_: None)
    assert scheduler.given == [("a",)]


def silent() -> None:
    raise RetryError("the cluster does not answer")


def test_what_is_refused_to_the_next_training_ends_none_that_runs(folder, monkeypatch):
    scheduler, warned = Scheduler(at_once=2), []
    Runner([training("a")], folder, scheduler).submit()
    later = Runner([training("a"), training("b")], folder, scheduler, warned.append)
    take = scheduler.submit
    monkeypatch.setattr(scheduler, "submit", refuse)
    looks = iter([nothing, nothing, lambda: monkeypatch.setattr(scheduler, "submit", take)])
    scheduler.meanwhile = lambda: next(looks, lambda: ends(folder, scheduler, training("b")))()
    folder.write_record("a", Record(list(training("a").words), State.RUNNING, 1))
    later.run(lambda *_: None)
    assert warned == ["too many jobs."]
    assert scheduler.given == [("a",), ("b",)]


def nothing() -> None:
    pass


def refuse(*_) -> None:
    raise RetryError("too many jobs")


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
        ends(folder, scheduler, training("a"))
        return found(self, name)

    monkeypatch.setattr(FarmFolder, "record", stale)
    asked.run(lambda *_: None)
    assert asked.is_done("a")


def test_a_record_that_can_never_be_read_does_not_hold_the_others_up(folder, monkeypatch):
    scheduler = Scheduler()
    asked = Runner([training("a")], folder, scheduler)
    asked.submit()
    scheduler.living.clear()
    monkeypatch.setattr(FarmFolder, "record", refuse)
    asked.run(lambda *_: None)
    assert asked.records["a"].state is State.LOST
    assert "too many" in asked.records["a"].told


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
    scheduler = Scheduler(at_once=1, outlived=False)
    asked = Runner([training("a"), training("b")], folder, scheduler)
    asked.submit()
    scheduler.meanwhile = lambda: scheduler.living.clear() if scheduler.stops == 3 else None
    asked.stop(lambda *_: None)
    assert scheduler.stops == 3
    assert asked.records["a"].state is State.STOPPED
    assert scheduler.given == [("a",)]


def test_a_folder_in_which_another_command_submits_for_long_is_refused(folder, monkeypatch):
    monkeypatch.setattr(lock, "LOCK_POLL_S", 0.01)
    monkeypatch.setattr(runner, "SUBMIT_WAIT_S", 0.05)
    with FarmFolder(folder.path).alone(), pytest.raises(RetryError, match="no other jghand train-many"):
        Runner([training("a")], folder, Scheduler()).submit()
    assert folder.record("a") is None
