# SPDX-License-Identifier: GPL-3.0-or-later
"""What differs between operating systems about other programs: naming one in a terminal, ending one with
all that it has started. Does not use bpy."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ..core import limits

# no window of a console flashes up; the other systems have none
HIDDEN = getattr(subprocess, "CREATE_NO_WINDOW", 0)
INTERPRETERS = ("bin/python", "bin/python3", "Scripts/python.exe", "python.exe")


def exists(path: Path) -> bool:
    """A folder that may not be read has nothing."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def is_file(path: Path) -> bool:
    """The same of files."""
    return exists(path) and path.is_file()


def interpreter_at(text: str, home: str = "") -> Path:
    """The interpreter that somebody means who chose `text`: a path, perhaps in quotation marks as it was copied, or the
    folder of an environment."""
    path = Path(text.strip().strip("\"'"))
    if home and path.parts[:1] == ("~",):
        path = Path(home, *path.parts[1:])
    if exists(path) and path.is_dir():
        return next((path / name for name in INTERPRETERS if is_file(path / name)), path)
    return path


def in_terminal(words: Sequence[str], platform: str = sys.platform) -> str:
    """A command to be copied into a terminal. On Windows that is PowerShell, which takes a first word in quotation
    marks for a text and not for a program."""
    quoted = [f'"{word}"' if not word or any(letter in word for letter in " ()&'") else word for word in words]
    call = "& " if platform == "win32" and quoted[0].startswith('"') else ""
    return call + " ".join(quoted)


def end_tree(process: subprocess.Popen[bytes], *, at_once: bool, platform: str = sys.platform) -> None:
    """Ends a process and those that it started. at_once: without asking; Windows has no other way."""
    if platform == "win32":
        _end_tree_of_windows(process)
        return
    with contextlib.suppress(OSError):
        os.killpg(process.pid, signal.SIGKILL if at_once else signal.SIGTERM)


def _end_tree_of_windows(process: subprocess.Popen[bytes]) -> None:
    system = os.environ.get("SYSTEMROOT", r"C:\Windows")
    words = [rf"{system}\System32\taskkill.exe", "/F", "/T", "/PID", str(process.pid)]
    with contextlib.suppress(OSError, subprocess.TimeoutExpired):
        subprocess.run(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=HIDDEN,
            timeout=limits.KILL_S,
            check=False,
        )
    with contextlib.suppress(OSError):
        process.kill()  # where that has failed
