"""What the scripts check_*.py share: other people's programs in environments of their own, and tables in pages."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def run(*command: str | Path) -> str:
    """What a program prints; RuntimeError with its last words when it fails."""
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, check=False, timeout=600)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, command))}: {(done.stdout + done.stderr).strip()[-2000:]}")
    return done.stdout


def python_of(environment: Path) -> Path:
    """The interpreter of an environment, which need not be there."""
    return environment / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def install_python(environment: Path, requirements: Path) -> None:
    """Makes the environment where it is not, and installs what the file pins."""
    if not python_of(environment).exists():
        run(sys.executable, "-m", "venv", environment)
    run(python_of(environment), "-m", "pip", "install", "-q", "-r", requirements)


def pins(requirements: Path) -> dict[str, str]:
    """Name -> version of a file of requirements."""
    return dict(line.split("==") for line in requirements.read_text().splitlines() if "==" in line)


def table(header: Sequence[str], rows: Sequence[Sequence[str]], words: int = 1) -> str:
    """A table as GitHub reads it, whose first columns hold words and the others numbers."""
    lines = [header, [*["---"] * words, *["---:"] * (len(header) - words)], *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def put_into_page(page: Path, script: str, text: str) -> None:
    """Replaces what stands between the marks of a script in a page."""
    begin, end = (f"<!-- scripts/{script}: {mark} -->" for mark in ("begin", "end"))
    before, rest = page.read_text(encoding="utf-8").split(begin)
    page.write_text(f"{before}{begin}\n{text}\n{end}{rest.split(end)[1]}", encoding="utf-8")
