"""The built zip, installed into an empty profile as a user does it."""

import json
import os
import subprocess
import sys

import build_extension
import pytest

TESTS = build_extension.ROOT / "tests"


@pytest.fixture(scope="module")
def installed(tmp_path_factory) -> dict:
    """What Blender held of the extension before, during and after; `said`: all that was printed."""
    folder = tmp_path_factory.mktemp("installed")
    archive = build_extension.build(folder)
    kept = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "BLENDER"))}
    done = subprocess.run(
        [sys.executable, "-W", "always", str(TESTS / "blender" / "install_extension.py"), str(archive)],
        capture_output=True, text=True, check=False, cwd=folder, timeout=300,
        env={**kept, "BLENDER_USER_RESOURCES": str(folder / "profile"), "PYTHONNOUSERSITE": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    said = [line for line in (done.stdout + done.stderr).splitlines() if line.strip()]
    result = json.loads(done.stdout.splitlines()[-1])
    return {**result, "said": [line for line in said if not line.startswith("{")]}


def test_the_zip_installs_into_an_empty_profile_and_is_enabled(installed):
    assert installed["before"]["types"] == []
    assert installed["first"]["properties"] == ["Object", "Scene"]
    assert "JGHandObjectSettings" in installed["first"]["types"]


def test_enabling_again_and_again_adds_nothing(installed):
    assert installed["again"] == installed["first"]


def test_disabling_takes_everything_away(installed):
    assert installed["after"] == installed["before"]


def test_nothing_warns_while_it_is_installed_and_enabled(installed):
    assert not [line for line in installed["said"] if "warning" in line.lower() or "error" in line.lower()]


def test_the_installed_extension_uses_its_own_copy_of_the_protocol_and_nothing_of_the_engine(installed):
    assert installed["protocol"] == "bl_ext.user_default.jghand.core.protocol"
    assert installed["engine"] == []


def test_the_installed_extension_poses_a_hand_without_the_engine(installed):
    assert installed["bent"] > 1
