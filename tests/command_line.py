"""The command line, run in this process."""

from __future__ import annotations

from jghand_engine.cli import main


def run(*words: object) -> int:
    """The exit code."""
    return main([str(word) for word in words])
