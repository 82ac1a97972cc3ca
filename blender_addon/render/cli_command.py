# SPDX-License-Identifier: GPL-3.0-or-later
"""`blender --command jghand …`: the batch renderer as a command of a Blender that has the extension."""

from __future__ import annotations

import sys
from typing import Any

import bpy

from ..errors import BAD_INPUT

COMMAND = "jghand"
_handle: Any = None


def command(arguments: list[str]) -> int:
    """Runs `render` with what follows it; returns the exit code."""
    if arguments[:1] != ["render"]:
        print(f"usage: blender --command {COMMAND} render FILE.blend --out FOLDER [--help]", file=sys.stderr)
        return 0 if arguments[:1] in (["--help"], ["-h"]) else BAD_INPUT
    from . import command as cli  # here: it needs the registration, which needs this module

    try:
        return cli.main(arguments[1:], program=f"blender --command {COMMAND} render")
    except SystemExit as ended:  # argparse ends so; Blender wants a number
        return ended.code if isinstance(ended.code, int) else BAD_INPUT


def register() -> None:
    """Adds the command."""
    global _handle
    if _handle is None:
        _handle = bpy.utils.register_cli_command(COMMAND, command)


def unregister() -> None:
    """Takes it away."""
    global _handle
    if _handle is not None:
        bpy.utils.unregister_cli_command(_handle)
        _handle = None
