"""`jghand train-many --executor slurm` on a real SLURM of one node: `python scripts/slurm_one_node.py COMMAND` runs
pytest, or anything else, while there is one."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from pathlib import Path

import pytest
from small_farm import COUNTING, begun, ends_as_if_undisturbed, record_of, train_many, write_list

from jghand_engine.farm.records import FarmFolder, State

if "JGHAND_SLURM" not in os.environ:
    pytest.skip("there is no SLURM to try it on: scripts/slurm_one_node.py", allow_module_level=True)
pytest.importorskip("submitit", reason="the extra farm is not installed")

SLURM = ("--executor", "slurm", "--partition", "low", "--memory-gb", "1", "--cpus")


def slurm(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout


def went_on(process: subprocess.Popen[str], out: Path, undisturbed: bytes) -> None:
    """The command ends well, after two starts of the training."""
    said, _ = process.communicate(timeout=300)
    assert process.returncode == 0, said
    assert (record_of(out).state, record_of(out).starts) == (State.FINISHED, 2)
    ends_as_if_undisturbed(out, undisturbed)


def test_a_list_becomes_an_array_of_jobs(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures, names=("one", "two")), tmp_path / "out"
    done = train_many(path, out, *SLURM, "1", "--json", str(tmp_path / "figures.json"))
    assert done.returncode == 0, done.stdout + done.stderr
    assert (out / "one.jghand").read_bytes() == undisturbed
    told = json.loads((tmp_path / "figures.json").read_text())["trainings"]
    assert [(one["state"], one["starts"]) for one in told.values()] == [("finished", 1)] * 2
    assert all(re.fullmatch(r"\d+_[01]", number) for number in FarmFolder(out).submitted().values())


def test_a_training_that_slurm_preempts_writes_its_checkpoint_and_is_queued_again(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    cores = str(os.cpu_count())
    process = begun(path, out, *SLURM, cores)
    # somebody more important wants the whole node
    slurm("sbatch", "--partition=high", f"--cpus-per-task={cores}", "--output=/dev/null", "--wrap=sleep 3")
    went_on(process, out, undisturbed)


def test_a_training_whose_time_is_up_is_queued_again(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    process = begun(path, out, *SLURM, "1")
    # the signal that sbatch was told to send before the end
    slurm("scancel", "--signal=USR2", FarmFolder(out).submitted()["one"])
    went_on(process, out, undisturbed)


def test_a_canceled_training_is_told_and_the_same_command_goes_on(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    process = begun(path, out, *SLURM, "1")
    slurm("scancel", FarmFolder(out).submitted()["one"])
    said, _ = process.communicate(timeout=300)
    assert process.returncode == 3, said
    assert record_of(out).state is State.STOPPED
    again = train_many(path, out, *SLURM, "1")
    assert again.returncode == 0, again.stdout + again.stderr
    ends_as_if_undisturbed(out, undisturbed)


def test_jobs_that_run_are_watched_and_not_submitted_twice(tmp_path):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    first = begun(path, out, *SLURM, "1", program=COUNTING)
    number = FarmFolder(out).submitted()["one"]
    first.send_signal(signal.SIGTERM)
    said, _ = first.communicate(timeout=60)
    assert first.returncode == 130, said
    assert "The jobs go on without this command" in said
    done = train_many(path, out, *SLURM, "1", program=COUNTING)
    assert done.returncode == 0, done.stdout
    assert FarmFolder(out).submitted()["one"] == number
    assert record_of(out).starts == 1


def test_a_list_that_is_changed_while_its_jobs_run_is_told_of_and_goes_on_afterwards(tmp_path):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    first = begun(path, out, *SLURM, "1", program=COUNTING)
    first.kill()
    first.wait()
    changed = write_list(tmp_path, tmp_path, steps=30)
    told = train_many(changed, out, *SLURM, "1", program=COUNTING)
    assert told.returncode == 3, told.stdout
    assert "one: changed since it was submitted; run the same command again." in told.stdout
    done = train_many(changed, out, *SLURM, "1", program=COUNTING)
    assert done.returncode == 0, done.stdout
    assert (out / "one.jghand").read_text() == "a hand of 30 steps"


def test_what_slurm_refuses_is_said(tmp_path):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    done = train_many(path, out, *SLURM, "1", "--sbatch", "constraint=absent")
    assert done.returncode == 3, done.stdout + done.stderr
    assert "SLURM did not take the jobs" in done.stderr
