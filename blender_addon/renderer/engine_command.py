# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the engine is: the Python that was chosen, the engine that the extension carries, the one of a checkout.

Drawing, motions and exports need nothing but what the extension carries. Training, tracking and captures need PyTorch
and more: the training tools (install_tools.py), or an environment of the user's that has it all. Does not use bpy.
"""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Mapping
from pathlib import Path

from ..errors import JGHandFailure

VARIABLE = "JGHAND_ENGINE_PYTHON"
# what the extension's zip carries beside its own modules; a checkout does not
CARRIED = Path(__file__).resolve().parents[1] / "engine"
_INTERPRETERS = ("bin/python", "bin/python3", "Scripts/python.exe", "python.exe")
# in Blender's own Python: what the engine needs beside Blender's numpy lies in the folders that are its first words
_RUN_CARRIED = (
    "import sys; sys.path[:0] = sys.argv[1:3]; del sys.argv[1:3]; from jghand_engine.cli import main; sys.exit(main())"
)
_SYSTEMS = {"linux": "linux", "darwin": "macos", "win32": "windows"}
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def engine_command(
    python: str | None = None, *, checkout: Path | None = None, environment: Mapping[str, str] = os.environ
) -> tuple[str, ...]:
    """The command that starts the engine as a service; as `engine_program`."""
    return (*engine_program(python, checkout=checkout, environment=environment), "serve")


def engine_program(
    python: str | None = None,
    *,
    checkout: Path | None = None,
    tools: Path | None = None,
    learns: bool = False,
    environment: Mapping[str, str] = os.environ,
) -> tuple[str, ...]:
    """The words before a verb of the engine's command line. The first that is given wins; a given one that does not
    exist is a failure.

    python: path of an interpreter that has jghand installed; then the variable JGHAND_ENGINE_PYTHON; then the engine
    that the extension carries; then `checkout`/.envs/engine.
    learns: for what needs PyTorch: `tools`, the interpreter of the training tools, stands in place of what is carried.
    Raises JGHandFailure: no_python or no_named_python for a given one, no_interpreter, or no_tools where only those are
    missing.
    """
    for missing, path in (("no_python", python), ("no_named_python", environment.get(VARIABLE))):
        if path:
            chosen = _interpreter_at(path)
            if not os.path.isfile(chosen):
                raise JGHandFailure(missing, path)
            return _by_python(chosen)
    if learns and tools is not None:
        return _by_python(tools)
    carried = (CARRIED / "common").is_dir()
    if carried and not learns:
        machine = platform.machine().lower()
        here = f"{_SYSTEMS.get(sys.platform, sys.platform)}_{_MACHINES.get(machine, machine)}"
        return sys.executable, "-I", "-c", _RUN_CARRIED, str(CARRIED / here), str(CARRIED / "common")
    if checkout is not None:
        made = _interpreter_at(str(checkout / ".envs" / "engine"))
        if os.path.isfile(made):
            return _by_python(made)
    if carried:
        raise JGHandFailure("no_tools")
    raise JGHandFailure("no_interpreter", "this is a checkout that was not installed: run scripts/demo.py once")


def _interpreter_at(text: str) -> Path:
    """The interpreter that somebody means who chose `text`: a path, perhaps in quotation marks as it was copied, or the
    folder of an environment."""
    path = Path(text.strip().strip("\"'")).expanduser()
    return next((path / name for name in _INTERPRETERS if os.path.isfile(path / name)), path)


def _by_python(path: Path) -> tuple[str, ...]:
    return str(path), "-I", "-m", "jghand_engine"
