"""The guard of these tests does what it says."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

TESTS = """
import pytest
from conftest import no_usd_warnings
from pxr import Tf

pytestmark = pytest.mark.usefixtures("no_usd_warnings")

@pytest.fixture(scope="module")
def made_once():
    if {warns}:
        Tf.Warn("a relationship was dropped")

def test_something(made_once):
    pass
"""


def test_a_warning_in_a_fixture_that_is_made_once_fails_the_module(tmp_path):
    for warns in (True, False):
        file = tmp_path / f"test_{warns}.py"
        file.write_text(TESTS.format(warns=warns))
        command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--rootdir", tmp_path, file]
        environment = {"PYTHONPATH": str(Path(__file__).parent)}
        done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=environment)
        assert done.returncode == int(warns), done.stdout + done.stderr
        assert ("a relationship was dropped" in done.stdout) == warns
