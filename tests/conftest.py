"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real input that is not part of the project; a test that wants it is skipped where it is absent."""
    folder = Path(os.environ.get("JGHAND_SHARED_DATA", Path(__file__).parents[2] / "shared" / "data"))
    if not folder.is_dir():
        pytest.skip("real input is not here: set JGHAND_SHARED_DATA to its folder")
    return folder
