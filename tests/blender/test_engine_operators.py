"""The engine by hand: checked, started, stopped and started again from buttons, which say why where they cannot."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import bpy
import pytest
from recording_layout import RecordingLayout, draw, operator_type

from blender_addon import preferences
from blender_addon.errors import JGHandFailure
from blender_addon.renderer import ops as engine
from blender_addon.renderer import panel as advanced
from blender_addon.renderer import programs, runtime
from blender_addon.renderer.engine_check import CheckResult, Finding
from blender_addon.renderer.engine_command import VARIABLE
from blender_addon.renderer.link import EngineLink


@pytest.fixture
def stand_in(extension, stand_in_command):
    """The link of this Blender, to a stand-in; faults may be put into the list."""
    faults: list[str] = []
    runtime.use_link(EngineLink(lambda: [*stand_in_command, *faults]))
    return faults


def refuses(operator: object) -> str:
    with pytest.raises(RuntimeError) as caught:
        operator()
    return str(caught.value)


def state() -> str:
    return runtime.link().status.state


def test_the_engine_is_started_stopped_and_started_again(stand_in):
    assert "not running" in refuses(bpy.ops.jghand.stop_engine)
    assert bpy.ops.jghand.start_engine() == {"FINISHED"}
    assert state() == "ready"
    first = runtime.link().status.handshake["pid"]
    assert "already" in refuses(bpy.ops.jghand.start_engine)
    assert bpy.ops.jghand.restart_engine() == {"FINISHED"}
    assert runtime.link().status.handshake["pid"] != first
    assert bpy.ops.jghand.stop_engine() == {"FINISHED"}
    assert state() in ("stopping", "stopped")


def test_a_start_that_fails_is_told_and_the_log_can_be_read(stand_in):
    assert "nothing yet" in refuses(bpy.ops.jghand.show_log)
    stand_in.append("die_at_start")
    said = refuses(bpy.ops.jghand.start_engine)
    assert "stopped unexpectedly" in said
    assert "no torch here" in said
    assert state() == "failed"
    assert bpy.ops.jghand.show_log() == {"FINISHED"}
    assert "no torch here" in bpy.data.texts[engine.LOG_NAME].as_string()
    stand_in.clear()
    assert bpy.ops.jghand.start_engine() == {"FINISHED"}
    assert bpy.ops.jghand.show_log() == {"FINISHED"}
    assert len(bpy.data.texts) == 1


def test_disabling_the_extension_ends_the_engine(stand_in):
    bpy.ops.jghand.start_engine()
    process = runtime.link()._engine.process.popen
    runtime.unregister()
    assert process.poll() is not None


def test_another_file_does_not_end_the_engine(stand_in):
    bpy.ops.jghand.start_engine()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert state() == "ready"


@pytest.mark.skipif(os.name == "nt", reason="the stand-in is a shell script")
def test_a_check_says_what_there_is_and_what_mends_it(extension, tmp_path, monkeypatch, capfd):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexit 1\n")
    python.chmod(0o755)
    monkeypatch.setenv(VARIABLE, str(python))
    assert bpy.ops.jghand.check_engine() == {"FINISHED"}
    result = runtime.check().result
    assert result.failure == "crashed"
    assert str(python) in capfd.readouterr().out
    runtime.look_again()
    assert runtime.check() is None


def test_a_check_of_the_python_of_blender_finds_no_engine(extension, monkeypatch):
    monkeypatch.setenv(VARIABLE, sys.executable)
    assert bpy.ops.jghand.check_engine() == {"FINISHED"}
    result = runtime.check().result
    assert result.failure == "no_engine"
    # JGHand's folder is known, because the extension is used out of it
    folder = str(Path(__file__).resolve().parents[2])
    assert result.mend == programs.in_terminal([sys.executable, "-m", "pip", "install", folder])


WRONG = CheckResult(
    (Finding("Path", "/somewhere/python"), Finding("Missing", "torch", False)),
    "broken_engine",
    "x" * 200,
    "pip install something",
    "JGHand's folder",
)


@pytest.mark.parametrize("result", [WRONG, CheckResult((Finding("Engine", "0.1.0"),))], ids=["wrong", "good"])
def test_the_result_is_drawn(extension, result):
    layout = RecordingLayout()
    engine.draw_result(layout, result)
    seen = " ".join(layout.texts)
    assert result.sentence in seen
    assert result.findings[0].value in seen
    assert result.mend in seen
    assert ("jghand.copy_command" in layout.operators) == bool(result.mend)


def test_the_sidebar_shows_the_result_in_short(extension, monkeypatch):
    monkeypatch.setenv(VARIABLE, "/nowhere/python")
    bpy.ops.jghand.check_engine()
    layout = draw(advanced.AdvancedPanel, extension)
    assert "No engine is set up" in " ".join(layout.texts)
    assert "jghand.copy_command" in layout.operators


def test_the_preferences_draw_the_button_and_the_newest_result(extension, monkeypatch):
    class Page:
        layout = RecordingLayout()
        bl_rna = preferences.JGHandPreferences.bl_rna

    preferences.JGHandPreferences.draw(Page(), extension)
    assert "jghand.check_engine" in Page.layout.operators
    monkeypatch.setenv(VARIABLE, "/nowhere/python")
    bpy.ops.jghand.check_engine()
    Page.layout = RecordingLayout()
    preferences.JGHandPreferences.draw(Page(), extension)
    assert "No engine is set up" in Page.layout.texts


def test_another_choice_of_python_starts_what_had_failed_anew(extension, stand_in_command):
    found: list[list[str]] = []

    def look() -> list[str]:
        if not found:
            raise JGHandFailure("no_interpreter")
        return found[0]

    runtime.use_link(EngineLink(look))
    assert "No engine is set up" in refuses(bpy.ops.jghand.start_engine)
    found.append(stand_in_command)
    runtime.look_again()
    runtime.link().wait_until_ready()
    assert state() == "ready"


def test_names_and_tooltips_follow_blenders_habits(extension):
    for each in engine.CLASSES:
        operator = operator_type(each.bl_idname)
        assert operator.name
        assert operator.description
        assert not operator.description.endswith(".")
