"""Tests inside Blender (the pip module bpy): an empty profile, an empty scene per test.

Where there is no bpy, as in the engine's environment, nothing below this folder is collected.
"""

import importlib.util
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TESTS = ROOT / "tests"

if importlib.util.find_spec("bpy") is None:
    collect_ignore_glob = ["test_*.py"]
else:
    _profile = tempfile.TemporaryDirectory(prefix="jghand_blender_")
    os.environ["BLENDER_USER_RESOURCES"] = _profile.name  # before bpy is imported: no test sees the user's settings
    sys.path[:0] = [str(ROOT), str(TESTS / "addon_core"), str(TESTS / "blender")]


@pytest.fixture
def context():
    """Blender's context with an empty scene of factory settings."""
    import bpy

    if bpy.context.preferences.is_dirty:
        bpy.ops.wm.read_factory_settings(use_empty=True)
        bpy.context.preferences.is_dirty = False
    else:  # takes a sixth of the time
        bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context


@pytest.fixture
def extension(context):
    """The same with the extension switched on."""
    import blender_addon

    blender_addon.register()
    yield context
    blender_addon.unregister()


@pytest.fixture(scope="session")
def stand_in_command() -> list[str]:
    """An engine that draws discs and needs no torch."""
    return [sys.executable, "-I", str(TESTS / "service" / "stand_in_engine.py")]


@pytest.fixture(scope="module")
def linked_extension(stand_in_command):
    """The extension switched on for all tests of a file, with the stand-in for its engine."""
    from blender_addon import registration
    from blender_addon.renderer import runtime
    from blender_addon.renderer.link import EngineLink

    registration.register()
    runtime.use_link(EngineLink(lambda: stand_in_command))
    yield
    runtime.use_link(None)
    registration.unregister()


@pytest.fixture(scope="session")
def engine_python() -> str:
    """The Python of the real engine; a test that wants it is skipped where it is not set up.

    With JGHAND_REQUIRE_ENGINE=1 it fails there instead: a run that is to show that the two work together.
    """
    for path in (os.environ.get("JGHAND_ENGINE_PYTHON"), *map(str, (ROOT / ".envs/engine").glob("*/python*"))):
        if path and Path(path).is_file():
            probe = subprocess.run([path, "-I", "-c", "import jghand_engine, torch"], capture_output=True, check=False)
            if probe.returncode == 0:
                return path
    sentence = "the engine is not installed: run scripts/test.py, or set JGHAND_ENGINE_PYTHON"
    if os.environ.get("JGHAND_REQUIRE_ENGINE", "0") not in ("", "0"):
        pytest.fail(sentence)
    pytest.skip(sentence)


@pytest.fixture
def engine(engine_python, monkeypatch) -> str:
    """The real engine for jobs."""
    monkeypatch.setenv("JGHAND_ENGINE_PYTHON", engine_python)
    return engine_python


@pytest.fixture(scope="module")
def real_engine(engine_python, linked_extension):
    """A link to the real engine, which is not the extension's."""
    from blender_addon.renderer.link import EngineLink
    from blender_addon.renderer.process import engine_command

    link = EngineLink(lambda: engine_command(engine_python))
    yield link
    link.close()
