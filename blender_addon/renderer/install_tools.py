# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes the training tools: `python -I install_tools.py FOLDER --engine E --constraints C PACKAGE …`.

A program of its own that Blender's Python runs as a job: an environment in FOLDER, the packages in the versions of the
constraints, and a line that lets it find the engine in E. FOLDER/ready.txt is there when all of it is, and is taken
away before anything is changed: a folder without it was never finished, and is finished by the next run. Says how far
it is as `jghand --progress-json` does, and ends when its standard input does.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shutil
import subprocess
import sys
import threading
from pathlib import Path

READY = "ready.txt"
_INTERRUPTED, _TRY_AGAIN = 130, 3
_TORCH_INDEX_VARIABLE = "JGHAND_TORCH_INDEX"  # a smaller PyTorch than PyPI's; scripts/environments.py knows it too
# no window of a console flashes up on Windows
HIDDEN = getattr(subprocess, "CREATE_NO_WINDOW", 0)
_running: list[subprocess.Popen[str]] = []


class InstallError(Exception):
    """A step failed; the text is for people."""


def interpreter(folder: Path) -> Path:
    return folder / ("Scripts/python.exe" if os.name == "nt" else "bin/python")


def fingerprint(constraints: Path, packages: list[str]) -> str:
    """What an environment is made of: another version of the extension may want another one."""
    return f"{sys.version_info[0]}.{sys.version_info[1]}\n{' '.join(packages)}\n{constraints.read_text('utf-8')}"


def install(folder: Path, engine: Path, constraints: Path, packages: list[str]) -> None:
    """Makes the environment, or mends it. InstallError."""
    (folder / READY).unlink(missing_ok=True)
    if importlib.util.find_spec("ensurepip") is None:  # Debian's Python has it in a package of its own
        raise InstallError("Blender runs on your system's Python, which lacks ensurepip: install its python3-venv")
    python = interpreter(folder)
    downloads = folder / "downloads"
    if not python.is_file() or _fails(str(python), "-I", "-c", "import pip"):
        _tell("Making the environment")
        shutil.rmtree(folder, ignore_errors=True)
        _run(sys.executable, "-I", "-m", "venv", str(folder))
    index = os.environ.get(_TORCH_INDEX_VARIABLE)
    extra = ("--extra-index-url", index) if index else ()
    if packages:
        _tell("Looking for the packages")
        words = ("install", "--disable-pip-version-check", "--progress-bar", "off", "-c", str(constraints))
        downloads.mkdir(exist_ok=True)
        # what pip keeps and unpacks stays in FOLDER, for the next run where this one ends early
        os.environ.update(dict.fromkeys(("PIP_CACHE_DIR", "TMPDIR", "TEMP", "TMP"), str(downloads)))
        _run(str(python), "-I", "-m", "pip", *words, *extra, *packages)
    _tell("Checking")
    found = subprocess.run(
        [str(python), "-I", "-c", "import sysconfig; print(sysconfig.get_path('purelib'))"],
        capture_output=True, text=True, check=True, creationflags=HIDDEN,
    )  # fmt: skip
    Path(found.stdout.strip(), "jghand_engine.pth").write_text(f"{engine}\n", "utf-8")
    _run(str(python), "-I", "-c", "import jghand_engine")
    if "torch" in packages:
        _run(str(python), "-I", "-c", "import torch; torch.zeros(1)")
    shutil.rmtree(downloads, ignore_errors=True)
    (folder / READY).write_text(fingerprint(constraints, packages), "utf-8")


def _run(*command: str) -> None:
    """Runs a command; what it prints is shown, and its newest line is how far it is."""
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        errors="replace",
        creationflags=HIDDEN,
    )
    _running[:] = [process]
    last = ""
    assert process.stdout is not None
    for line in process.stdout:
        last = line.strip() or last
        print(line, end="", flush=True)
        if line.startswith(("Collecting", "Downloading", "Installing")):
            _tell(line.strip()[:60])
    if process.wait():
        raise InstallError(last or f"{Path(command[0]).name} ended with exit code {process.returncode}")


def _fails(*command: str) -> bool:
    try:
        return subprocess.run(command, capture_output=True, check=False, creationflags=HIDDEN).returncode != 0
    except OSError:
        return True


def _tell(text: str) -> None:
    print(json.dumps({"jghand": "progress", "text": text}), file=sys.stderr, flush=True)


def _end_with_input() -> None:
    while os.read(0, 1024):  # not through sys.stdin, whose lock the end of this program would wait for
        pass
    for process in _running:
        process.kill()
    os._exit(_INTERRUPTED)


def main() -> int:
    parser = argparse.ArgumentParser()
    parser.add_argument("folder", type=Path)
    parser.add_argument("packages", nargs="*")
    parser.add_argument("--engine", type=Path, required=True)
    parser.add_argument("--constraints", type=Path, required=True)
    parser.add_argument("--progress-json", action="store_true")
    options = parser.parse_intermixed_args()  # before 3.12, others leave packages that come after options
    threading.Thread(target=_end_with_input, daemon=True).start()
    try:
        install(options.folder, options.engine, options.constraints, options.packages)
    except (InstallError, OSError, subprocess.SubprocessError) as error:
        print(json.dumps({"jghand": "error", "kind": "tools_failed", "text": str(error)}), file=sys.stderr, flush=True)
        return _TRY_AGAIN
    return 0


if __name__ == "__main__":
    sys.exit(main())
