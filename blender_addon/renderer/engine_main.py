# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts the engine that the extension carries: `python -I engine_main.py VERB …`, in Blender's own Python.

A program of its own, which nothing imports: a kernel that crashes never takes the scene down. What the engine needs
beside Blender's numpy lies in the extension's folder `engine`, seen by this process alone.
"""

from __future__ import annotations

import platform
import sys
from pathlib import Path

ENGINE = Path(__file__).resolve().parents[1] / "engine"
_SYSTEMS = {"linux": "linux", "darwin": "macos", "win32": "windows"}
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def folders() -> list[Path]:
    """Where the engine's packages lie for this machine."""
    machine = platform.machine().lower()
    here = f"{_SYSTEMS.get(sys.platform, sys.platform)}_{_MACHINES.get(machine, machine)}"
    return [ENGINE / here, ENGINE / "common"]


def main() -> int:
    sys.path[:0] = [str(folder) for folder in folders()]
    from jghand_engine.cli import main as engine

    return engine()


if __name__ == "__main__":
    sys.exit(main())
