"""One door to all data sets: a folder goes in, a capture comes out, whatever its layout."""

from __future__ import annotations

from pathlib import Path

from jghand_engine.datasets.captures import Capture, CaptureChoice
from jghand_engine.datasets.interhand import read_interhand


def open_capture(folder: Path | str, *, choice: CaptureChoice | None = None) -> Capture:
    """The pictures of one hand in a folder of a known layout."""
    return read_interhand(folder, choice)
