"""scripts/demo.py: what it sets up, and what it hands to the engine's command."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import demo
import pytest
from environments import SetupError


@pytest.fixture
def script(monkeypatch):
    """Runs the script without setting anything up; returns what was set up, and the command that was run."""

    def run(*arguments, missing=()):
        set_up, commands = [], []

        def ensure(environment):
            if environment.name in missing:
                raise SetupError("No usable Python was found.")
            set_up.append(environment.name)
            return Path(f"/{environment.name}/python")

        def start(command, **_):
            commands.append(command)
            return subprocess.CompletedProcess(command, 0)

        monkeypatch.setattr(demo.environments, "ensure", ensure)
        monkeypatch.setattr(demo.subprocess, "run", start)
        monkeypatch.setattr(sys, "argv", ["demo.py", *arguments])
        assert demo.main() == 0
        return set_up, commands

    return run


@pytest.mark.parametrize("word", ["--help", "-h"])
def test_help_sets_nothing_up(script, word):
    set_up, [command] = script(word)
    assert set_up == []
    assert command == [sys.executable, str(demo.JOB), "--help"]


def test_the_help_of_the_job_needs_no_package():
    done = subprocess.run([sys.executable, "-I", "-S", demo.JOB, "--help"], capture_output=True, text=True, check=True)
    assert "--blender-python" in done.stdout


def test_both_environments_are_set_up_and_used(script):
    set_up, [command] = script("--hand", "left")
    assert set_up == ["engine", "blender"]
    assert command[:4] == ["/engine/python", str(demo.JOB), "--hand", "left"]
    assert command[-4:] == ["--out", str(demo.ROOT / "demo_output"), "--blender-python", "/blender/python"]


@pytest.mark.parametrize("given", [("--blender-python", "/mine"), ("--blender-python=/mine",)])
def test_a_python_for_blender_that_is_named_is_taken(script, given):
    set_up, [command] = script(*given, "--out=here")
    assert set_up == ["engine"]
    assert command[2:] == [*given, "--out=here"]


def test_without_blender_the_demo_goes_on(script, capsys):
    set_up, [command] = script(missing=("blender",))
    assert set_up == ["engine"]
    assert "--blender-python" not in command
    assert "goes on without Blender" in capsys.readouterr().out
