# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the engine is: what was asked for, the environment, this checkout, the command `jghand`, JGHand's scripts."""

from __future__ import annotations

import contextlib
import os
import re
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ..errors import JGHandFailure
from .programs import exists, find_command, interpreter_at, is_file

VARIABLE = "JGHAND_ENGINE_PYTHON"
# a file of one line: the interpreter of the environment that scripts/ made last (scripts/environments.py writes it)
NOTE = "engine_python.txt"
_SERVE = ("serve", "--stdio-handshake")
_INTERPRETERS = ("bin/python", "Scripts/python.exe")
# what makes a folder an environment: of venv, of conda
_ENVIRONMENT_MARKS = ("pyvenv.cfg", "conda-meta")
# the first line of a command, or the second one, which pip writes for long paths
_SHEBANG = re.compile(r"\A#!\s*(?:/bin/sh\s+'''exec'\s+)?\"?(/[^\n\"]*?python[\d.]*)\"?(?=\s|\Z)")
_SHEBANG_BYTES = 1024


@dataclass(frozen=True)
class FoundEngine:
    """origin: how it was found, in words · program: the words before a verb of its command line · python: its
    interpreter, None where only a command is known"""

    origin: str
    program: tuple[str, ...]
    python: str | None


def engine_command(
    python: str | None = None, *, checkout: Path | None = None, environment: Mapping[str, str] = os.environ
) -> tuple[str, ...]:
    """The command that starts the engine as a service; as `find_engine`."""
    return (*engine_program(python, checkout=checkout, environment=environment), *_SERVE)


def engine_program(
    python: str | None = None, *, checkout: Path | None = None, environment: Mapping[str, str] = os.environ
) -> tuple[str, ...]:
    """The words before a verb of the engine's command line; as `find_engine`."""
    return find_engine(python, checkout=checkout, environment=environment).program


def find_engine(
    python: str | None = None, *, checkout: Path | None = None, environment: Mapping[str, str] = os.environ
) -> FoundEngine:
    """The engine. The first that is given wins; a given one that does not exist is a failure.

    python: path of an interpreter that has jghand installed; then the variable JGHAND_ENGINE_PYTHON; then
    `checkout`/.envs/engine; then `jghand` on the PATH; then the environment that JGHand's scripts made.
    Raises JGHandFailure (no_interpreter).
    """
    for origin, path in (("The Python that was chosen", python), (VARIABLE, environment.get(VARIABLE))):
        if path:
            chosen = interpreter_at(path, environment.get("USERPROFILE", environment.get("HOME", "")))
            if not is_file(chosen):
                raise JGHandFailure("no_interpreter", f"{origin}: {path} is no file, or one that cannot be looked at")
            return _by_python(origin, str(chosen))
    if checkout is not None:
        for name in _INTERPRETERS:
            if is_file(checkout / ".envs/engine" / name):
                return _by_python("The environment of this checkout", str(checkout / ".envs/engine" / name))
    script = find_command("jghand", environment)
    if script:
        return FoundEngine("The command jghand on the PATH", (script,), _python_of(script))
    made = _made_by_scripts(environment)
    if made is not None:
        return _by_python("The environment that JGHand's scripts made", made)
    raise JGHandFailure("no_interpreter", f"neither {VARIABLE}, nor .envs/engine, nor a command jghand")


def note_folder(environment: Mapping[str, str], platform: str = sys.platform) -> Path | None:
    """Where the scripts note what they made; JGHAND_CONFIG_DIR names another place. None for a user without a home."""
    if named := environment.get("JGHAND_CONFIG_DIR"):
        return Path(named)
    if platform == "win32":
        base, below = environment.get("LOCALAPPDATA"), "jghand"
    elif platform == "darwin":
        base, below = environment.get("HOME"), "Library/Application Support/jghand"
    else:
        base, below = environment.get("XDG_CONFIG_HOME"), "jghand"
        if not base:
            base, below = environment.get("HOME"), ".config/jghand"
    return Path(base) / below if base else None


def _made_by_scripts(environment: Mapping[str, str]) -> str | None:
    folder = note_folder(environment)
    if folder is None:
        return None
    with contextlib.suppress(OSError, ValueError):
        python = (folder / NOTE).read_text(encoding="utf-8").strip()
        if python and is_file(Path(python)):
            return python
    return None


def _by_python(origin: str, path: str) -> FoundEngine:
    return FoundEngine(origin, (path, "-I", "-m", "jghand_engine"), path)


def _python_of(script: str) -> str | None:
    """The interpreter that a command is run by: the one of its environment, else the one that it names itself, else the
    one of the folder that has it among its Scripts. Links to a command are followed."""
    try:
        real = Path(script).resolve()
    except (OSError, RuntimeError):  # a ring of links
        return None
    for folder in dict.fromkeys((Path(script).parent, real.parent)):
        if any(exists(folder.parent / mark) for mark in _ENVIRONMENT_MARKS):
            # conda on Windows has its Python above its commands
            for python in (folder / "python", folder / "python3", folder / "python.exe", folder.parent / "python.exe"):
                if is_file(python):
                    return str(python)
    above = real.parent.parent / "python.exe"
    return _named_by(real) or (str(above) if is_file(above) else None)


def _named_by(script: Path) -> str | None:
    """The interpreter that a script names in its first lines."""
    with contextlib.suppress(OSError):
        with script.open("rb") as file:
            begin = file.read(_SHEBANG_BYTES).decode("utf-8", "replace")
        named = _SHEBANG.match(begin)
        if named and is_file(Path(named[1])):
            return named[1]
    return None
