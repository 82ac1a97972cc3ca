"""`jghand train-many --executor slurm` on a real SLURM of one node: `python scripts/slurm_one_node.py COMMAND` runs
pytest, or anything else, while there is one."""

from __future__ import annotations

import json
import os
import re
import subprocess
import time
from pathlib import Path

import pytest
from small_farm import TINY, environment, train_many, wait_for_step, write_list

from jghand_engine.farm.records import FarmFolder, State

if "JGHAND_SLURM" not in os.environ:
    pytest.skip("there is no SLURM to try it on: scripts/slurm_one_node.py", allow_module_level=True)
pytest.importorskip("submitit", reason="the extra farm is not installed")

SLURM = ("--executor", "slurm", "--partition", "low", "--memory-gb", "1", "--cpus")


def slurm(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout


def begun(path: Path, out: Path, cpus: str) -> subprocess.Popen[str]:
    """The command, once the training is at work."""
    command = [*TINY, "train-many", str(path), "--out", str(out), *SLURM, cpus]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, env=environment(0.4)
    )
    wait_for_step(out, 4)
    return process


def went_on_at(out: Path) -> int:
    logs = "".join(path.read_text() for path in (out / "jobs" / "logs").glob("*_log.err"))
    found = re.search(r"Going on at step (\d+)", logs)
    assert found, logs
    return int(found[1])


def finished_at_the_second_start(process: subprocess.Popen[str], out: Path, undisturbed: bytes) -> None:
    said, _ = process.communicate(timeout=300)
    assert process.returncode == 0, said
    record = FarmFolder(out).record("one")
    assert record is not None
    assert (record.state, record.starts) == (State.FINISHED, 2)
    assert went_on_at(out) >= 4
    assert (out / "one.jghand").read_bytes() == undisturbed


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
    process = begun(path, out, cores)
    # somebody more important wants the whole node
    slurm("sbatch", "--partition=high", f"--cpus-per-task={cores}", "--output=/dev/null", "--wrap=sleep 3")
    finished_at_the_second_start(process, out, undisturbed)


def test_a_training_whose_time_is_up_is_queued_again(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    process = begun(path, out, "1")
    # the signal that sbatch was told to send before the end
    slurm("scancel", "--signal=USR2", FarmFolder(out).submitted()["one"])
    finished_at_the_second_start(process, out, undisturbed)


def test_a_cancelled_training_is_told_and_the_same_command_goes_on(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    process = begun(path, out, "1")
    slurm("scancel", FarmFolder(out).submitted()["one"])
    said, _ = process.communicate(timeout=300)
    assert process.returncode == 3, said
    assert FarmFolder(out).record("one").state is State.STOPPED
    again = train_many(path, out, *SLURM, "1")
    assert again.returncode == 0, again.stdout + again.stderr
    assert went_on_at(out) >= 4
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_jobs_that_run_are_watched_and_not_submitted_twice(pictures, tmp_path):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    assert train_many(path, out, *SLURM, "1", "--submit-only", step_s=0.2).returncode == 0
    number = FarmFolder(out).submitted()["one"]
    until = time.monotonic() + 60
    while FarmFolder(out).record("one").state is State.WAITING:
        assert time.monotonic() < until
        time.sleep(0.2)
    done = train_many(path, out, *SLURM, "1")
    assert done.returncode == 0, done.stdout
    assert FarmFolder(out).submitted()["one"] == number
    assert FarmFolder(out).record("one").starts == 1


def test_what_slurm_refuses_is_said(pictures, tmp_path):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    done = train_many(path, out, *SLURM, "1", "--sbatch", "constraint=absent")
    assert done.returncode == 3, done.stdout + done.stderr
    assert "SLURM did not take the jobs" in done.stderr
