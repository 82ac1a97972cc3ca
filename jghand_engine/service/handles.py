"""The standard handles of a process that another program has started."""

from __future__ import annotations

import os
import sys


def take_stdin() -> int:
    """A handle of stdin for the parent's word alone; whoever else looks finds nothing there. On Windows a library that
    asks what stdin is waits for the thread that reads it: torch's and scipy's may, while they are loaded."""
    mine, nothing = os.dup(0), os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    return mine


def print_any_letter() -> None:
    """What is printed may have every letter: on Windows a pipe takes those of one old code page alone, and any other
    would end the command."""
    for stream in (sys.stdout, sys.stderr):
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None:
            reconfigure(encoding="utf-8", errors="replace")
