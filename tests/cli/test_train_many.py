"""`jghand train-many`: what a list may say; trainings stopped, killed and gone on with; the array of jobs of SLURM."""

import json
import os
import pickle
import signal
import subprocess
import sys
import threading
from importlib.util import find_spec
from pathlib import Path

import pytest
from waiting import wait_until

from jghand_engine.cli import main, train_many
from jghand_engine.cli.train_many import TrainingJob, read_list
from jghand_engine.errors import STOPPED, InputError

# trainings of a model of 300 Gaussians, and trainings that only count
TINY = (sys.executable, str(Path(__file__).with_name("tiny_jghand.py")))
COUNTING = (*TINY, "--counting")
STEPS = 24


@pytest.fixture(autouse=True)
def counting(monkeypatch):
    monkeypatch.setattr(train_many, "PROGRAM", COUNTING)


@pytest.fixture
def slow(monkeypatch):
    """A training that is to be stopped takes half a second for a step, from its fifth on."""
    monkeypatch.setenv("JGHAND_TINY_STEP_S", "0.5")


def write_list(folder: Path, pictures: Path, names=("one",), **entries) -> Path:
    lines = [f"{key} = {json.dumps(value)}" for key, value in {"steps": STEPS, **entries}.items()]
    tables = [f'[[training]]\nfolder = "{pictures}"\nname = "{name}"' for name in names]
    path = folder / "captures.toml"
    path.write_text("\n".join([*lines, *tables]), encoding="utf-8")
    return path


def job(tmp_path: Path, name: str = "one") -> TrainingJob:
    return TrainingJob(name, (str(tmp_path), "--steps", str(STEPS)), tmp_path)


def run(path: Path, out: Path, *words) -> int:
    return main(["train-many", str(path), "--out", str(out), *map(str, words)])


def wait_for_step(out: Path, number: int) -> None:
    wait_until(lambda: f"step {number} of" in (out / "one.log").read_text(), f"step {number}")


# ---- the list --------------------------------------------------------------------------------------------------------


def test_what_holds_for_all_is_overridden_by_each(tmp_path):
    (tmp_path / "id3").mkdir()
    path = tmp_path / "list.toml"
    text = 'minutes = 60\nsequences = ["a", "b"]\n[[training]]\nfolder = "id3"\n'
    path.write_text(text + '[[training]]\nfolder = "id3"\nname = "second"\nminutes = 120\nall_pictures = true\n')
    pictures = str((tmp_path / "id3").resolve())
    assert read_list(path) == {
        "id3": (pictures, "--minutes", "60", "--sequences", "a", "b"),
        "second": (pictures, "--all-pictures", "--minutes", "120", "--sequences", "a", "b"),
    }


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("minutes = ", "TOML"),
        ("minutes = 60", r"\[\[training\]\]"),
        ('[[training]]\nfolder = "nowhere"', "a folder of pictures"),
        ('[[training]]\nfolder = "."\nname = "../x"', "signs of file names"),
        ('[[training]]\nfolder = "."\n[[training]]\nfolder = "."', "more than once"),
        ('[[training]]\nfolder = "."\nname = "x"\nout = "y"', "what train-many decides"),
        ('[[training]]\nfolder = "."\nname = "x"\nmintes = 5', "jghand train takes"),
        ('[[training]]\nfolder = "."\nname = "x"\nsteps = "many"', "jghand train takes"),
        ('[[training]]\nfolder = "."\nname = "x"\nsteps = 0', "1 or more"),
    ],
)
def test_what_a_list_cannot_say_is_refused_before_anything_begins(tmp_path, text, said):
    (tmp_path / "list.toml").write_text(text)
    with pytest.raises(InputError, match=said):
        read_list(tmp_path / "list.toml")


# ---- here ------------------------------------------------------------------------------------------------------------


def test_every_training_becomes_an_avatar_and_a_second_run_does_nothing(tmp_path, capsys):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two")), tmp_path / "out"
    assert run(path, out, "--jobs", 2, "--json", tmp_path / "figures.json") == 0
    told = json.loads((tmp_path / "figures.json").read_text())["trainings"]
    assert [(one["state"], one["exit_code"]) for one in told.values()] == [("finished", 0)] * 2
    log = (out / "one.log").read_text()
    assert run(path, out) == 0
    assert "2 trainings, 2 of them finished already" in capsys.readouterr().out
    assert (out / "one.log").read_text() == log


def test_more_steps_go_on_where_the_training_ended(tmp_path):
    out = tmp_path / "out"
    assert run(write_list(tmp_path, tmp_path), out) == 0
    assert run(write_list(tmp_path, tmp_path, steps=30), out) == 0
    assert (out / "one.jghand").read_text() == "a hand of 30 steps"
    assert "Resuming at step 24" in (out / "one.log").read_text()


def test_one_that_fails_does_not_stop_the_others_and_says_why(tmp_path, capsys):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two")), tmp_path / "out"
    out.mkdir()
    (out / "one.jghand").write_text("somebody's")
    assert run(path, out) == 2
    assert "--overwrite" in capsys.readouterr().out
    assert (out / "one.jghand").read_text() == "somebody's"
    assert (out / "two.jghand").is_file()


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL])
def test_a_command_that_ends_lets_its_trainings_write_their_checkpoints(tmp_path, number):
    path, out = write_list(tmp_path, tmp_path), tmp_path / "out"
    out.mkdir()
    words = [*COUNTING, "train-many", str(path), "--out", str(out)]
    environment = {**os.environ, "JGHAND_TINY_STEP_S": "0.5"}
    process = subprocess.Popen(words, env=environment, stdout=subprocess.PIPE, text=True, start_new_session=True)
    wait_until((out / "one.log").is_file, "its log")
    wait_for_step(out, 5)
    process.send_signal(number)
    said, _ = process.communicate(timeout=60)
    wait_until((out / "one.training" / "checkpoint").is_file, "its checkpoint")
    if number == signal.SIGINT:
        assert process.returncode == STOPPED, said
        assert "Stopping" in said
    wait_until(lambda: run(path, out) == 0, "the end of the training")
    assert "Resuming at step" in (out / "one.log").read_text()


# ---- SLURM -----------------------------------------------------------------------------------------------------------

needs_submitit = pytest.mark.skipif(find_spec("submitit") is None, reason="the extra farm is not installed")


@pytest.fixture
def cluster(tmp_path, monkeypatch) -> Path:
    """Programs named as SLURM's; what sbatch was given is kept in the folder."""
    folder = tmp_path / "bin"
    folder.mkdir()
    text = f'#!/bin/sh\nfor last; do :; done\ncp "$last" "{folder}/script"\necho Submitted batch job 42\n'
    for name in ("sbatch", "srun"):
        (folder / name).write_text(text)
        (folder / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    return folder


@needs_submitit
def test_a_list_becomes_an_array_of_jobs_that_are_queued_again(tmp_path, cluster, capsys):
    path, out = write_list(tmp_path, tmp_path, names=("one", "two")), tmp_path / "out"
    assert run(path, out, "--slurm", "partition=cpu", "time=60", "account=hands") == 0
    assert "42_0, 42_1" in capsys.readouterr().out
    script = (cluster / "script").read_text()
    for line in ("array=0-1", "partition=cpu", "time=60", "account=hands", "mem=8GB", "signal=USR2@90"):
        assert f"#SBATCH --{line}" in script
    assert (out / "jobs").stat().st_mode & 0o777 == 0o700


@needs_submitit
def test_a_job_can_be_carried_to_another_process_and_trains_there(tmp_path):
    again = pickle.loads(pickle.dumps(job(tmp_path)))
    assert again() == f"step {STEPS} of {STEPS}"
    assert again.is_finished


@needs_submitit
def test_a_preempted_job_writes_its_checkpoint_and_is_the_same_job_again(tmp_path, slow):
    one = job(tmp_path)
    thread = threading.Thread(target=one.train, args=(threading.Event(),))
    thread.start()
    wait_until((tmp_path / "one.log").is_file, "its log")
    wait_for_step(tmp_path, 5)
    delayed = one.checkpoint()
    thread.join(timeout=60)
    assert int((tmp_path / "one.training" / "checkpoint").read_text()) >= 5
    assert delayed.function == one
    assert delayed.function() == f"step {STEPS} of {STEPS}"


def test_without_a_cluster_the_command_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("PATH", str(tmp_path))
    assert run(write_list(tmp_path, tmp_path), tmp_path / "out", "--slurm", "partition=cpu") == 2
    assert "SLURM" in capsys.readouterr().err
    assert run(write_list(tmp_path, tmp_path), tmp_path / "out", "--slurm", "cpu") == 2
