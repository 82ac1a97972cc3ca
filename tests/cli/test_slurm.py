"""`jghand train-many --slurm` on a real SLURM of one node: `python scripts/slurm_one_node.py COMMAND` runs pytest, or
anything else, while there is one."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from picture_sets import recorded, write_set
from waiting import wait_until

if "JGHAND_SLURM" not in os.environ:
    pytest.skip("there is no SLURM to try it on: scripts/slurm_one_node.py", allow_module_level=True)
pytest.importorskip("submitit", reason="the extra farm is not installed")

TINY = (sys.executable, str(Path(__file__).with_name("tiny_jghand.py")))
STEPS = 24
WAIT_S = 300.0


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> Path:
    return write_set(tmp_path_factory.mktemp("set"), recorded(frames=4, cameras=4))


@pytest.fixture(scope="module")
def undisturbed(pictures, tmp_path_factory) -> bytes:
    """The avatar of a training that nobody stopped."""
    out = tmp_path_factory.mktemp("undisturbed") / "one.jghand"
    words = ["train", str(pictures), "--steps", str(STEPS), "--out", str(out)]
    subprocess.run([*TINY, *words], check=True, capture_output=True)
    return out.read_bytes()


def slurm(*words: str) -> str:
    return subprocess.run(words, capture_output=True, text=True, check=True, timeout=60).stdout


def submitted(folder: Path, pictures: Path, *options: str, names=("one",), step_s: float = 0.0) -> Path:
    """The folder of the avatars of a list that was submitted."""
    tables = [f'[[training]]\nfolder = "{pictures}"\nname = "{name}"' for name in names]
    path, out = folder / "list.toml", folder / "out"
    path.write_text("\n".join([f"steps = {STEPS}", *tables]), encoding="utf-8")
    words = [*TINY, "train-many", str(path), "--out", str(out), "--slurm", "partition=low", "mem=1GB", *options]
    done = subprocess.run(words, env={**os.environ, "JGHAND_TINY_STEP_S": str(step_s)}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return out


def wait_for(out: Path, text: str) -> None:
    log = out / "one.log"
    wait_until(lambda: log.is_file() and text in log.read_text(), text, most_s=WAIT_S)


def ends_as_if_undisturbed(out: Path, undisturbed: bytes) -> None:
    wait_until((out / "one.training" / "finished.json").is_file, "the end", most_s=WAIT_S)
    assert "Resuming at step" in (out / "one.log").read_text()
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_a_list_becomes_an_array_of_jobs(pictures, tmp_path, undisturbed):
    out = submitted(tmp_path, pictures, "cpus_per_task=1", names=("one", "two"))
    for name in ("one", "two"):
        wait_until((out / f"{name}.training" / "finished.json").is_file, "the end", most_s=WAIT_S)
    assert (out / "one.jghand").read_bytes() == undisturbed


def test_a_training_that_slurm_preempts_writes_its_checkpoint_and_is_queued_again(pictures, tmp_path, undisturbed):
    cores = str(os.cpu_count())
    out = submitted(tmp_path, pictures, f"cpus_per_task={cores}", step_s=0.5)
    wait_for(out, "step 5 of")
    # somebody more important wants the whole node
    slurm("sbatch", "--partition=high", f"--cpus-per-task={cores}", "--output=/dev/null", "--wrap=sleep 3")
    ends_as_if_undisturbed(out, undisturbed)


def test_a_training_whose_time_is_up_is_queued_again(pictures, tmp_path, undisturbed):
    out = submitted(tmp_path, pictures, "cpus_per_task=1", step_s=0.5)
    wait_for(out, "step 5 of")
    # the signal that sbatch was told to send before the end
    number = slurm("squeue", "--me", "--noheader", "--format=%i").split()[0]
    slurm("scancel", "--signal=USR2", number)
    ends_as_if_undisturbed(out, undisturbed)
