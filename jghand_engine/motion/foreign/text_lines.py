"""Lines of a text whose content is not trusted: a line that never ends is refused before it is all read."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TextIO

from jghand_engine import limits


def bounded_lines(stream: TextIO, most: int = limits.TEXT_LINE_MAX) -> Iterator[str]:
    """The lines of a stream. ValueError for one of `most` characters or more."""
    while line := stream.readline(most):
        if len(line) >= most and not line.endswith("\n"):
            raise ValueError(f"a line of more than {most} characters")
        yield line
