"""Waiting for what other processes do."""

import time
from collections.abc import Callable
from typing import Any, TypeVar

import pytest

Found = TypeVar("Found")


def wait_until(found: Callable[[], Found], what: str, most_s: float = 90.0) -> Found:
    """The first of its values that is true; the test fails where there is none for so long."""
    until_s = time.monotonic() + most_s
    while time.monotonic() < until_s:
        if value := found():
            return value
        time.sleep(0.01)
    pytest.fail(f"for {most_s:g} s nothing came of: {what}")


def wait_for_count(job: Any) -> None:
    """Until a job of the extension has said how far it is."""

    def total() -> float:
        job.tick()
        return job.state.total

    wait_until(total, "a count")
