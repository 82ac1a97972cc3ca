"""A small set of pictures, and the avatar that a training of it ends in when nobody stops it."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from picture_sets import recorded, write_set
from small_farm import STEPS, TINY, end_what_was_started, environment


@pytest.fixture(autouse=True)
def nothing_is_left() -> Iterator[None]:
    """Of the commands that a test started, also where it fails."""
    yield
    end_what_was_started()


@pytest.fixture(scope="session")
def pictures(tmp_path_factory) -> Path:
    """4 poses and 4 cameras."""
    return write_set(tmp_path_factory.mktemp("set"), recorded(frames=4, cameras=4))


@pytest.fixture(scope="session")
def undisturbed(pictures, tmp_path_factory) -> bytes:
    """The avatar of a training that nobody stopped."""
    folder = tmp_path_factory.mktemp("undisturbed")
    words = ["train", str(pictures), "--steps", str(STEPS), "--out", str(folder / "one.jghand")]
    subprocess.run([*TINY, *words], check=True, capture_output=True, env=environment())
    return (folder / "one.jghand").read_bytes()
