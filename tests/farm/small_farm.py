"""What the tests of trainings by the list share: a tiny command, a list, and how one waits."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from jghand_engine.farm.records import FarmFolder

TINY = (sys.executable, str(Path(__file__).with_name("tiny_jghand.py")))
STEPS = 24


def environment(step_s: float = 0.0) -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "JGHAND_TINY_STEP_S": str(step_s)}


def write_list(folder: Path, pictures: Path, names=("one",), **entries) -> Path:
    lines = [f"{key} = {json.dumps(value)}" for key, value in {"steps": STEPS, **entries}.items()]
    tables = [f'[[training]]\nfolder = "{pictures}"\nname = "{name}"' for name in names]
    path = folder / "captures.toml"
    path.write_text("\n".join([*lines, *tables]), encoding="utf-8")
    return path


def train_many(path: Path, out: Path, *words: str, step_s: float = 0.0) -> subprocess.CompletedProcess[str]:
    command = [*TINY, "train-many", str(path), "--out", str(out), *words]
    return subprocess.run(command, capture_output=True, text=True, timeout=180, env=environment(step_s))


def wait_for_step(out: Path, number: int) -> None:
    """Until the record of a training tells of that step."""
    until = time.monotonic() + 90
    while time.monotonic() < until:
        record = FarmFolder(out).record("one")
        done = re.match(r"step (\d+) of", record.progress) if record else None
        if done and int(done[1]) >= number:
            return
        time.sleep(0.05)
    pytest.fail(f"step {number} never came")
