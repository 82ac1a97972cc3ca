"""Real captures with Cycles of one hand, as small as can be."""

import subprocess
import sys
from pathlib import Path

WIDTH, HEIGHT = 64, 96


def make(engine_python: str, folder: Path, program: str, *words: str) -> str:
    """Runs `jghand capture` into a folder by a Python program; returns what it said."""
    command = [engine_python, "-c", program, "capture", "--out", str(folder), "--blender-python", sys.executable]
    command += ["--identity", "adult_woman", "--close-ups", "0", "--size", f"{WIDTH}x{HEIGHT}", "--threads", "1"]
    done = subprocess.run([*command, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout
