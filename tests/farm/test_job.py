"""A training as a scheduler runs it, with programs that do as they are told."""

from __future__ import annotations

import errno
import io
import os
import signal
import sys
import threading
import time

import pytest
from waiting import wait_until

from jghand_engine.errors import RetryError
from jghand_engine.farm import job
from jghand_engine.farm.child import Child
from jghand_engine.farm.job import TrainingJob
from jghand_engine.farm.records import FarmFolder, Record, State
from jghand_engine.farm.trainings import Training
from jghand_engine.files import writing
from jghand_engine.lock import locked

WORDS = ("train", "pictures")


@pytest.fixture
def folder(tmp_path) -> FarmFolder:
    made = FarmFolder(tmp_path / "out")
    made.make()
    return made


def job_of(folder: FarmFolder, code: str) -> TrainingJob:
    """Its program is Python code, which is given the words of the command."""
    return TrainingJob(Training("one", WORDS), folder.path, (sys.executable, "-c", code), note_every_s=0.05)


def record_of(folder: FarmFolder) -> Record:
    record = folder.record("one")
    assert record is not None
    return record


MAKE_AVATAR = "import sys; from pathlib import Path; Path(sys.argv[sys.argv.index('--out') + 1]).touch()\n"
SAY_HALF = """sys.stderr.write('{"jghand": "training", "text": "half"}\\n'); sys.stderr.flush()\n"""


def test_a_training_that_ends_well_is_finished(folder):
    assert job_of(folder, MAKE_AVATAR + SAY_HALF)() == "one: half"
    assert record_of(folder) == Record(list(WORDS), State.FINISHED, 1, 0, "", "half", os.uname().nodename)


def test_what_a_training_says_at_its_end_is_noted(folder):
    code = """import sys; sys.stderr.write('{"jghand": "error", "text": "no pictures"}\\n'); sys.exit(2)"""
    with pytest.raises(RuntimeError, match="exit code 2: no pictures"):
        job_of(folder, code)()
    record = record_of(folder)
    assert (record.state, record.exit_code, record.told) == (State.FAILED, 2, "no pictures")


def test_a_polite_kill_ends_its_input_and_it_is_stopped(folder):
    code = "import sys, os; " + SAY_HALF + "sys.stdin.read(); sys.exit(130)"
    at_half(folder, signal.SIGTERM)
    with pytest.raises(RetryError, match="was stopped"):
        job_of(folder, code)()
    assert record_of(folder).state is State.STOPPED


def at_half(folder: FarmFolder, number: int) -> None:
    """Sends this process a signal when the record of the training says half."""

    def is_there() -> bool:
        record = folder.record("one")
        return record is not None and record.progress == "half"

    def run() -> None:
        try:
            wait_until(is_there, "a note", 30.0)
        finally:
            # also where nothing comes of it: the job would wait for ever
            kill_me(number)

    threading.Thread(target=run).start()


def kill_me(number: int) -> None:
    os.kill(os.getpid(), number)


def test_a_note_that_cannot_be_written_is_no_reason_to_stop(folder, monkeypatch):
    written = []

    def full_until_the_end(self, name, record):
        written.append(record.state)
        if written[-1] is State.RUNNING or written.count(State.FINISHED) < 3:
            raise RetryError("the disk is full")

    monkeypatch.setattr(FarmFolder, "write_record", full_until_the_end)
    assert job_of(folder, MAKE_AVATAR + "import time; time.sleep(0.5)")()
    assert written.count(State.RUNNING) >= 2
    assert written[-3:] == [State.FINISHED] * 3, "the last is tried again until it is there"


def test_a_note_that_can_never_be_written_is_given_up(folder, monkeypatch):
    monkeypatch.setattr(job, "RECORD_WAIT_S", 0.1)
    monkeypatch.setattr(FarmFolder, "write_record", refused)
    assert job_of(folder, MAKE_AVATAR)()


def refused(*_) -> None:
    raise RetryError("the disk is full")


def test_a_damaged_record_is_no_reason_not_to_train(folder):
    (folder.jobs / "records" / "one.json").write_text("{}")
    assert job_of(folder, MAKE_AVATAR)()
    assert record_of(folder).starts == 1


class FullDisk(io.StringIO):
    """A log on it."""

    def write(self, text: str) -> int:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))


def test_a_log_that_cannot_be_written_does_not_hold_the_training_up(monkeypatch):
    monkeypatch.setattr(sys, "stderr", FullDisk())
    # far more than a pipe holds
    code = "import sys\nfor _ in range(4000): sys.stderr.write('a warning of some length, again and again\\n')"
    training = Child([sys.executable, "-c", code])
    try:
        wait_until(lambda: training.poll() is not None, "its end", 20.0)
    finally:
        training.kill()


def test_the_end_of_its_input_reaches_a_training_of_a_job_that_hears_no_ctrl_c():
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        training = Child([sys.executable, "-c", "import signal, sys; sys.exit(len(signal.pthread_sigmask(0, [])))"])
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    assert wait_until(lambda: [training.poll()] if training.poll() is not None else None, "its end") == [len(before)]


def test_a_second_job_of_a_training_waits_for_the_first_and_has_then_nothing_to_do(folder):
    done = Record(list(WORDS), State.FINISHED, 1, 0)

    def first() -> None:
        with locked(folder.lock("one")):
            began.set()
            time.sleep(0.5)
            folder.avatar("one").touch()
            folder.write_record("one", done)

    began = threading.Event()
    threading.Thread(target=first).start()
    began.wait()
    assert job_of(folder, "import sys; sys.exit(1)")() == "one: "
    assert record_of(folder) == done


def test_a_job_waits_for_a_training_that_lost_its_own_and_writes_its_checkpoint(folder, capfd):
    work = folder.work("one")
    work.mkdir()

    def orphan() -> None:
        with locked(work / "lock"):
            began.set()
            time.sleep(0.5)
            with writing(work / "training.json") as temporary:
                temporary.touch()

    began = threading.Event()
    threading.Thread(target=orphan).start()
    began.wait()
    # it is gone on with
    assert job_of(folder, MAKE_AVATAR + "assert '--resume' in sys.argv")()
    assert record_of(folder).starts == 1
    assert "Waiting for its end." in capfd.readouterr().err


def test_a_job_that_waits_for_another_can_be_stopped(folder, monkeypatch):
    def asked_to_stop(path, **how):
        kill_me(signal.SIGTERM)
        return locked(path, **how)

    with locked(folder.lock("one")), monkeypatch.context() as patched, pytest.raises(RetryError, match="was stopped"):
        patched.setattr(job, "locked", asked_to_stop)
        job_of(folder, "")()
    assert folder.record("one") is None, "what is noted is the other's"


def test_the_same_job_goes_on_after_a_checkpoint(folder):
    pytest.importorskip("submitit", reason="the extra farm is not installed")
    asked = job_of(folder, "import sys; " + SAY_HALF + "sys.stdin.read(); sys.exit(130)")
    again: list = []
    before = signal.signal(signal.SIGUSR2, lambda *_: again.append(asked.checkpoint()))
    at_half(folder, signal.SIGUSR2)
    try:
        with pytest.raises(RetryError, match="was stopped"):
            asked()
    finally:
        signal.signal(signal.SIGUSR2, before)
    assert again[0].function == asked
    assert record_of(folder).state is State.STOPPED
