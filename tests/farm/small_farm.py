"""What the tests of trainings by the list share: tiny commands, a list, and how one waits."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import wait_until

from jghand_engine.farm.records import FarmFolder, Record

# commands whose trainings are small, and whose trainings only count
TINY = (sys.executable, str(Path(__file__).with_name("tiny_jghand.py")))
COUNTING = (*TINY, "--counting")
STEPS = 24
# seconds of a step of a training that is to be stopped, from its fifth on: ten seconds are left for that
SLOW_S = 0.5
STARTED: list[subprocess.Popen[str]] = []


def environment(step_s: float = 0.0) -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "JGHAND_TINY_STEP_S": str(step_s)}


def write_list(folder: Path, pictures: Path, names=("one",), **entries) -> Path:
    lines = [f"{key} = {json.dumps(value)}" for key, value in {"steps": STEPS, **entries}.items()]
    tables = [f'[[training]]\nfolder = "{pictures}"\nname = "{name}"' for name in names]
    path = folder / "captures.toml"
    path.write_text("\n".join([*lines, *tables]), encoding="utf-8")
    return path


def train_many(path: Path, out: Path, *words: str, program: tuple[str, ...] = TINY) -> subprocess.CompletedProcess[str]:
    command = [*program, "train-many", str(path), "--out", str(out), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=180, env=environment())


def started(
    path: Path, out: Path, *words: str, program: tuple[str, ...] = TINY, step_s: float = SLOW_S
) -> subprocess.Popen[str]:
    """The command in a session of its own, as in a terminal, with slow steps. It ends with the test."""
    process = subprocess.Popen(
        [*program, "train-many", str(path), "--out", str(out), *words], stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT, text=True, env=environment(step_s), start_new_session=True, preexec_fn=_hear_the_end,
    )  # fmt: skip
    STARTED.append(process)
    return process


def _hear_the_end() -> None:
    """A closed terminal ends commands, also where the tests were started with `nohup`."""
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def end_what_was_started() -> None:
    """Their jobs too, which are of their group; trainings end when those do."""
    while STARTED:
        process = STARTED.pop()
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def begun(path: Path, out: Path, *words: str, program: tuple[str, ...] = TINY) -> subprocess.Popen[str]:
    """The same, once its training is at them."""
    process = started(path, out, *words, program=program)
    wait_for_step(out, 4)
    return process


def wait_for_step(out: Path, number: int) -> None:
    """Until the record of a training tells of that step."""

    def is_there() -> bool:
        record = FarmFolder(out).record("one")
        done = re.match(r"step (\d+) of", record.progress) if record else None
        return done is not None and int(done[1]) >= number

    wait_until(is_there, f"step {number}")


def record_of(out: Path, name: str = "one") -> Record:
    record = FarmFolder(out).record(name)
    assert record is not None
    return record


def logs_of(out: Path) -> str:
    return "".join(path.read_text() for path in sorted((out / "jobs" / "logs").glob("*_log.err")))


def ends_as_if_undisturbed(out: Path, undisturbed: bytes) -> None:
    """A training that was stopped went on where it was, and made the avatar that nobody's would."""
    went_on_at = re.findall(r"Going on at step (\d+)", logs_of(out))
    assert went_on_at, logs_of(out)
    assert max(map(int, went_on_at)) >= 4, "the checkpoint is of the moment, not of the beginning"
    assert (out / "one.jghand").read_bytes() == undisturbed


def processes_with(word: str) -> dict[int, list[str]]:
    """Number -> words of the command, of the processes that have `word` among them."""
    if not Path("/proc/self/cmdline").is_file():
        pytest.skip("there is no /proc to find processes in")
    found = {}
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().decode(errors="replace").split("\0")
        except OSError:
            continue
        # those that ended and wait to be asked for have no words left
        if any(word in one for one in words):
            found[int(path.parent.name)] = words
    return found
