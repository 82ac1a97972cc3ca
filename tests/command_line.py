"""The command line, run in this process."""

from jghand_engine.cli import main


def run(*words: object) -> int:
    """The exit code."""
    return main([str(word) for word in words])
