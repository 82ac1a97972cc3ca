"""`jghand train-many` on this machine: trainings preempted, killed, stopped, left alone, and gone on with."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path

import pytest
from small_farm import (
    COUNTING,
    begun,
    ends_as_if_undisturbed,
    logs_of,
    processes_with,
    record_of,
    started,
    train_many,
    write_list,
)
from waiting import wait_until

from jghand_engine.avatar.file import load_avatar
from jghand_engine.farm.records import State

pytest.importorskip("submitit", reason="the extra farm is not installed")


def training_of(out: Path, name: str = "one") -> int:
    """The process of a training."""
    return next(number for number, words in processes_with(f"{out}/{name}.jghand").items() if "train" in words)


def job_of(out: Path) -> list[int]:
    """The processes of submitit, which hold it."""
    return list(processes_with(str(out / "jobs" / "logs")))


# ---- a real training -------------------------------------------------------------------------------------------------


def test_a_preempted_training_is_queued_again_and_ends_in_the_same_bits(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    process = begun(path, out)
    # as a scheduler does: a polite kill, and the signal that asks for a checkpoint
    (number,) = (number for number, words in processes_with(str(out)).items() if "submitit.core._submit" in words)
    os.kill(number, signal.SIGTERM)
    os.kill(number, signal.SIGUSR2)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 0, said
    assert (record_of(out).state, record_of(out).starts) == (State.FINISHED, 2)
    assert load_avatar(out / "one.jghand").info.name == "one"
    ends_as_if_undisturbed(out, undisturbed)


def test_a_training_that_is_to_have_more_steps_goes_on_and_replaces_its_avatar(pictures, tmp_path):
    out = tmp_path / "out"
    for steps in (4, 6):
        done = train_many(write_list(tmp_path, pictures, steps=steps), out)
        assert done.returncode == 0, done.stdout + done.stderr
    assert record_of(out).starts == 2
    assert "Going on at step 4" in logs_of(out)


# ---- trainings that only count ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_ctrl_c_and_a_closed_terminal_stop_the_trainings_politely_and_the_same_command_goes_on(tmp_path, number):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    process = begun(path, out, program=COUNTING)
    # all processes of a terminal get it
    os.killpg(process.pid, number)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert "Stopping" in said
    assert record_of(out).state is State.STOPPED, said
    assert train_many(path, out, program=COUNTING).returncode == 0
    ends_as_if_undisturbed(out, b"a hand of 24 steps")


def test_every_training_of_a_list_becomes_an_avatar_and_a_second_run_does_nothing(tmp_path):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two")), tmp_path / "out"
    done = train_many(path, out, "--json", str(tmp_path / "figures.json"), "--jobs", "2", program=COUNTING)
    assert done.returncode == 0, done.stdout + done.stderr
    assert all((out / f"{name}.jghand").is_file() for name in ("one", "two"))
    told = json.loads((tmp_path / "figures.json").read_text())["trainings"]
    assert [(one["state"], one["starts"], one["exit_code"]) for one in told.values()] == [("finished", 1, 0)] * 2
    assert (out / "jobs" / "logs").stat().st_mode & 0o777 == 0o700
    again = train_many(path, out, program=COUNTING)
    assert again.returncode == 0
    assert "Trainings: 2, of which 2 are finished already" in again.stdout
    assert record_of(out).starts == 1


def test_a_training_that_is_killed_is_told_and_goes_on(tmp_path):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    process = begun(path, out, program=COUNTING)
    os.kill(training_of(out), signal.SIGKILL)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 3, said
    assert (record_of(out).state, record_of(out).exit_code) == (State.FAILED, -signal.SIGKILL)
    (out / "one.training" / "checkpoint").write_text("2")
    assert train_many(path, out, program=COUNTING).returncode == 0
    assert record_of(out).starts == 2
    assert "Going on at step 2." in logs_of(out)


def test_a_killed_job_takes_its_training_along_which_writes_its_checkpoint(tmp_path):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    process = begun(path, out, program=COUNTING)
    for number in job_of(out):
        os.kill(number, signal.SIGKILL)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 3, said
    assert "one: lost" in said
    # at once: it waits for the checkpoint
    assert train_many(path, out, program=COUNTING).returncode == 0
    ends_as_if_undisturbed(out, b"a hand of 24 steps")


def test_a_training_that_outlived_its_command_is_waited_for_and_not_begun_twice(tmp_path):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two")), tmp_path / "out"
    process = begun(path, out, program=COUNTING)
    process.kill()
    process.wait()
    again = started(path, out, program=COUNTING, step_s=0.0)
    wait_until(lambda: "Waiting for its end." in logs_of(out), "a second job that waits")
    os.kill(training_of(out), signal.SIGUSR1)
    said, _ = again.communicate(timeout=60)
    assert again.returncode == 0, said
    assert [record_of(out, name).state for name in ("one", "two")] == [State.FINISHED] * 2
    assert record_of(out).starts == 1
    assert not any(word in said for word in ("failed", "lost"))


def test_a_second_command_beside_it_begins_no_training_twice(tmp_path):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two")), tmp_path / "out"
    process = begun(path, out, program=COUNTING)
    beside = started(path, out, program=COUNTING, step_s=0.0)
    wait_until(lambda: "Waiting for its end." in logs_of(out), "a second job that waits")
    os.kill(training_of(out), signal.SIGUSR1)
    for command in (beside, process):
        said, _ = command.communicate(timeout=60)
        assert command.returncode == 0, said
    assert [record_of(out, name).starts for name in ("one", "two")] == [1, 1]


def test_a_command_that_fails_takes_its_trainings_along(tmp_path):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two", "three")), tmp_path / "out"
    process = begun(path, out, "--jobs", "2", program=COUNTING)
    wait_until((out / "two.training" / "lock").exists, "the second training")
    # the record of the third cannot be written
    (out / "jobs" / "records" / "three.json").mkdir()
    os.kill(training_of(out, "two"), signal.SIGKILL)
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 2, said
    assert not processes_with(str(out))
    assert record_of(out).state is State.STOPPED
    assert "Stopping" in said


def test_what_a_training_refuses_is_said_and_can_be_allowed(tmp_path):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    out.mkdir()
    (out / "one.jghand").write_text("somebody's")
    done = train_many(path, out, program=COUNTING)
    assert done.returncode == 2
    assert "--overwrite" in done.stdout
    assert "overwrite = true" in done.stdout
    assert (out / "one.jghand").read_text() == "somebody's"
    assert train_many(write_list(tmp_path, tmp_path, overwrite=True), out, program=COUNTING).returncode == 0
    assert (out / "one.jghand").read_text() == "a hand of 24 steps"
