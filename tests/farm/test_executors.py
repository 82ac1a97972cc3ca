"""What is asked of SLURM, with commands that only note it. tests/farm/test_slurm.py has a real one."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from jghand_engine.errors import InputError, RetryError
from jghand_engine.farm import executors
from jghand_engine.farm.executors import LocalExecutor, SlurmExecutor, SlurmOptions
from jghand_engine.farm.signals import held_back

pytest.importorskip("submitit", reason="the extra farm is not installed")


@pytest.fixture
def sbatch(tmp_path, monkeypatch) -> Path:
    """Where the script that it was given is found."""
    commands = tmp_path / "bin"
    commands.mkdir()
    noted = tmp_path / "noted"
    bodies = {"srun": "exit 0", "squeue": "exit 0", "sbatch": f'cp "$1" {noted}; echo Submitted batch job 77'}
    for name, body in bodies.items():
        (commands / name).write_text(f"#!/bin/sh\n{body}\n")
        (commands / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{commands}:{os.environ['PATH']}")
    return noted


def submitted(tmp_path: Path, count: int, running: int = 0) -> dict[str, str]:
    executor = SlurmExecutor(tmp_path / "logs", SlurmOptions(), running)
    return executor.submit({f"hand {number}": list for number in range(count)})


def test_as_many_jobs_run_at_once_as_the_cluster_lets(sbatch, tmp_path):
    numbers = submitted(tmp_path, 300)
    assert len(numbers) == len(set(numbers.values())) == 300
    assert "--array=0-299%300" in sbatch.read_text()


def test_or_as_many_as_were_asked_for(sbatch, tmp_path):
    submitted(tmp_path, 300, running=20)
    assert "--array=0-299%20" in sbatch.read_text()


SUBMITS_ONE = """
import signal, sys
from pathlib import Path
from jghand_engine.farm.executors import SlurmExecutor, SlurmOptions
from jghand_engine.farm.signals import STOPS
for number in STOPS:
    signal.signal(number, lambda got, _: print("heard", got))
print(SlurmExecutor(Path(sys.argv[1]), SlurmOptions(), 0).submit({"one": len}))
"""

# like the real one it leaves blocked what it finds blocked; a shell of Debian would not
INTERRUPTED_SBATCH = """
import os, signal
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    os.kill(os.getppid(), number)
    os.kill(os.getpid(), number)
print("Submitted batch job 77")
"""


def test_sbatch_hears_neither_ctrl_c_nor_a_polite_kill_nor_a_hang_up_and_the_command_does(sbatch, tmp_path):
    # everybody in a terminal gets it
    (tmp_path / "bin" / "sbatch").write_text(f"#!{sys.executable}\n{INTERRUPTED_SBATCH}")
    command = [sys.executable, "-c", SUBMITS_ONE, str(tmp_path / "logs")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert sorted(done.stdout.splitlines()) == ["heard 1", "heard 15", "heard 2", "{'one': '77'}"], done.stderr


@pytest.mark.parametrize("threads", [1, 3])
def test_ctrl_c_while_a_local_job_is_started_takes_effect_then(tmp_path, monkeypatch, threads):
    executor = LocalExecutor(tmp_path, 1)

    def start(job):
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.05)  # another thread may take it
        return SimpleNamespace(job_id="1")

    monkeypatch.setattr(executor._executor, "submit", start)
    with idle_threads(threads - 1), pytest.raises(KeyboardInterrupt), held_back():
        noted = executor.submit({"one": dict})
    assert noted == {"one": "1"}


def test_a_local_job_is_started_deaf_to_ctrl_c_and_to_the_end_of_the_terminal(tmp_path, monkeypatch):
    executor = LocalExecutor(tmp_path, 1)
    blocked = "import signal; print(*sorted(signal.pthread_sigmask(signal.SIG_BLOCK, [])))"

    def start(job):
        done = subprocess.run([sys.executable, "-c", blocked], capture_output=True, text=True, check=True)
        return SimpleNamespace(job_id=done.stdout.strip())

    monkeypatch.setattr(executor._executor, "submit", start)
    assert executor.submit({"one": dict}) == {"one": f"{signal.SIGHUP:d} {signal.SIGINT:d}"}


@contextlib.contextmanager
def idle_threads(count: int) -> Iterator[None]:
    """Threads that block no signal, such as those of torch."""
    end = threading.Event()
    threads = [threading.Thread(target=end.wait) for _ in range(count)]
    for thread in threads:
        thread.start()
    try:
        yield
    finally:
        end.set()
        for thread in threads:
            thread.join()


@pytest.mark.parametrize(
    ("squeue", "told"), [("echo no controller >&2; exit 1", "no controller"), ("exec sleep 60", "timed out")]
)
def test_a_cluster_that_does_not_answer_is_told(sbatch, tmp_path, monkeypatch, squeue, told):
    monkeypatch.setattr(executors, "SLURM_ANSWER_S", 0.2 if "sleep" in squeue else 60.0)
    (tmp_path / "bin" / "squeue").write_text(f"#!/bin/sh\n{squeue}\n")
    with pytest.raises(RetryError, match=f"does not answer.*{told}"):
        SlurmExecutor(tmp_path / "logs", SlurmOptions(), 0).alive(["77"])


def test_systems_without_such_signals_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(executors.sys, "platform", "win32")
    with pytest.raises(InputError, match="wanted Linux"):
        LocalExecutor(tmp_path, 1)


def test_what_sbatch_refuses_is_said(sbatch, tmp_path):
    (tmp_path / "bin" / "sbatch").write_text("#!/bin/sh\necho invalid partition >&2; exit 1\n")
    with pytest.raises(RetryError, match="invalid partition"):
        submitted(tmp_path, 2)
