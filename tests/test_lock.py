"""Locks: one process at a time, and whoever is kept out is told by whom."""

import os
import platform
import re
import sys

import pytest

from jghand_engine.errors import RetryError
from jghand_engine.lock import locked


@pytest.mark.skipif(sys.platform == "win32", reason="nobody else can read the file there")
def test_who_holds_a_lock_is_told_with_the_machine(tmp_path):
    (tmp_path / "lock").write_bytes(b" 12345678        \n")  # of an earlier version
    with locked(tmp_path / "lock"):
        told = re.escape(f"process {os.getpid()} on {platform.node()}. Wait")
        with pytest.raises(RetryError, match=told), locked(tmp_path / "lock"):
            pytest.fail("it is held")


def test_a_folder_that_is_not_there_is_told(tmp_path):
    with pytest.raises(RetryError, match="cannot write"), locked(tmp_path / "absent" / "lock"):
        pytest.fail("there is nothing to lock")
