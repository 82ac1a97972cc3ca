"""`jghand train-many` on this machine: real small trainings, preempted, killed, stopped, and gone on with."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from pathlib import Path

import pytest
from small_farm import TINY, environment, train_many, wait_for_step, write_list

from jghand_engine.avatar.file import load_avatar
from jghand_engine.farm import job, runner
from jghand_engine.farm.records import FarmFolder, State
from jghand_engine.farm.trainings import read_trainings

pytest.importorskip("submitit", reason="the extra farm is not installed")
from jghand_engine.farm.executors import LocalExecutor


def processes_with(word: str) -> dict[int, list[str]]:
    """Number -> words of the command, of the processes that have `word` among them."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        if any(word in one for one in words):
            found[int(path.parent.name)] = words
    return found


def training_process(out: Path) -> int:
    return next(number for number, words in processes_with(str(out)).items() if "train" in words)


def test_every_training_of_a_list_becomes_an_avatar_and_a_second_run_does_nothing(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures, names=("one", "two")), tmp_path / "out"
    done = train_many(path, out, "--json", str(tmp_path / "figures.json"), "--jobs", "2")
    assert done.returncode == 0, done.stdout + done.stderr
    assert [load_avatar(out / f"{name}.jghand").info.name for name in ("one", "two")] == ["one", "two"]
    assert (out / "one.jghand").read_bytes() == undisturbed
    told = json.loads((tmp_path / "figures.json").read_text())["trainings"]
    assert [(one["state"], one["starts"], one["exit_code"]) for one in told.values()] == [("finished", 1, 0)] * 2
    assert (out / "jobs" / "logs").stat().st_mode & 0o777 == 0o700
    again = train_many(path, out)
    assert again.returncode == 0
    assert "2 trainings, 2 of them finished already" in again.stdout
    assert FarmFolder(out).record("one").starts == 1


@pytest.fixture
def local(monkeypatch, tmp_path):
    """Runs a list in this process, so that a test can lay hands on its jobs."""
    monkeypatch.setattr(job, "PROGRAM", TINY)
    for name, value in environment(0.4).items():
        monkeypatch.setenv(name, value)

    def start(path: Path) -> runner.Runner:
        folder = FarmFolder(tmp_path / "out")
        folder.make()
        return runner.Runner(read_trainings(path), folder, LocalExecutor(folder.logs, 1))

    return start


def test_a_preempted_training_is_queued_again_and_ends_in_the_same_bits(pictures, tmp_path, undisturbed, local):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    running = local(path)
    running.submit()
    wait_for_step(out, 4)
    # as a scheduler does: a polite kill, and the signal that asks for a checkpoint
    (number,) = (number for number, words in processes_with(str(out)).items() if "submitit.core._submit" in words)
    os.kill(number, signal.SIGTERM)
    os.kill(number, signal.SIGUSR2)
    running.run(lambda *_: None)
    record = running.records["one"]
    assert (record.state, record.starts) == (State.FINISHED, 2)
    logs = "".join(path.read_text() for path in (out / "jobs" / "logs").glob("*_log.err"))
    began = re.search(r"Going on at step (\d+)", logs)
    assert began, logs
    assert int(began[1]) >= 4, "the checkpoint is of the moment, not of the beginning"
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_a_training_that_is_killed_is_told_and_goes_on(pictures, tmp_path, undisturbed, local):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    running = local(path)
    running.submit()
    wait_for_step(out, 4)
    os.kill(training_process(out), signal.SIGKILL)
    running.run(lambda *_: None)
    record = running.records["one"]
    assert (record.state, record.exit_code) == (State.FAILED, -signal.SIGKILL)
    again = train_many(path, out)
    assert again.returncode == 0
    assert FarmFolder(out).record("one").starts == 2
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_a_killed_job_takes_its_training_along_which_writes_its_checkpoint(pictures, tmp_path, undisturbed, local):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    running = local(path)
    running.submit()
    wait_for_step(out, 4)
    child = training_process(out)
    for number in processes_with(str(out / "jobs" / "logs")):
        os.kill(number, signal.SIGKILL)
    running.run(lambda *_: None)
    assert running.records["one"].state is State.LOST
    until = time.monotonic() + 60
    while Path(f"/proc/{child}").exists() and Path(f"/proc/{child}/stat").read_text().split()[2] != "Z":
        assert time.monotonic() < until
        time.sleep(0.05)
    assert max((out / "one.training" / "checkpoints").iterdir()).name >= "step_00000004.safetensors"
    assert train_many(path, out).returncode == 0
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_ctrl_c_stops_the_trainings_politely_and_the_same_command_goes_on(pictures, tmp_path, undisturbed):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    command = [*TINY, "train-many", str(path), "--out", str(out)]
    # a session of its own, whose processes all get Ctrl-C, as those of a terminal
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment(0.3),
        start_new_session=True,
    )
    until = time.monotonic() + 90
    while not (out / "one.training" / "log.jsonl").exists():
        assert time.monotonic() < until
        time.sleep(0.05)
    time.sleep(1.0)
    os.killpg(process.pid, signal.SIGINT)
    said, _ = process.communicate(timeout=120)
    assert process.returncode == 130, said
    assert "Stopping" in said
    assert FarmFolder(out).record("one").state is State.STOPPED, said
    assert train_many(path, out).returncode == 0
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_what_a_training_refuses_is_said(pictures, tmp_path):
    path, out = write_list(tmp_path, pictures), tmp_path / "out"
    out.mkdir()
    (out / "one.jghand").write_text("somebody's")
    done = train_many(path, out)
    assert done.returncode == 2
    assert "--overwrite" in done.stdout
    assert (out / "one.jghand").read_text() == "somebody's"
