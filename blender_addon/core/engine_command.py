# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the engine is: what was asked for, the environment, this checkout, the command `jghand`."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping
from pathlib import Path

from .messages import JGHandFailure

VARIABLE = "JGHAND_ENGINE_PYTHON"
_SERVE = ("serve", "--stdio-handshake")
_INTERPRETERS = ("bin/python", "Scripts/python.exe")


def engine_command(
    python: str | None = None, *, checkout: Path | None = None, environment: Mapping[str, str] = os.environ
) -> tuple[str, ...]:
    """The command that starts the engine as a service; as `engine_program`."""
    return (*engine_program(python, checkout=checkout, environment=environment), *_SERVE)


def engine_program(
    python: str | None = None, *, checkout: Path | None = None, environment: Mapping[str, str] = os.environ
) -> tuple[str, ...]:
    """The words before a verb of the engine's command line. The first place that is given wins; a given one that does
    not exist is a failure.

    python: path of an interpreter that has jghand installed; then the variable JGHAND_ENGINE_PYTHON; then
    `checkout`/.envs/engine; then `jghand` on the PATH. Raises JGHandFailure (no_interpreter).
    """
    for origin, path in (("--engine-python", python), (VARIABLE, environment.get(VARIABLE))):
        if path:
            if not Path(path).is_file():
                raise JGHandFailure("no_interpreter", f"{origin} names {path}, which is no file")
            return _module(path)
    if checkout is not None:
        for name in _INTERPRETERS:
            if (checkout / ".envs/engine" / name).is_file():
                return _module(str(checkout / ".envs/engine" / name))
    script = shutil.which("jghand", path=environment.get("PATH"))
    if script:
        return (script,)
    raise JGHandFailure("no_interpreter", f"neither {VARIABLE}, nor .envs/engine, nor a command jghand")


def _module(python: str) -> tuple[str, ...]:
    return (python, "-I", "-m", "jghand_engine")
