"""The engine by hand: started, stopped and started again from buttons, which say why where they cannot."""

import subprocess
import zipfile
from pathlib import Path
from types import SimpleNamespace

import bpy
import pytest
from recording_layout import RecordingLayout

from blender_addon import preferences
from blender_addon.errors import JGHandFailure
from blender_addon.renderer import install_tools, runtime
from blender_addon.renderer import ops as engine
from blender_addon.renderer.link import EngineLink
from blender_addon.renderer.process import VARIABLE


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


def test_the_engine_is_started_and_started_again(stand_in):
    assert bpy.ops.jghand.restart_engine() == {"FINISHED"}
    assert state() == "ready"
    first = runtime.link().status.handshake["pid"]
    assert bpy.ops.jghand.restart_engine() == {"FINISHED"}
    assert runtime.link().status.handshake["pid"] != first


def test_a_start_that_fails_is_told_and_the_log_can_be_read(stand_in):
    assert bpy.ops.jghand.show_log() == {"FINISHED"}
    assert "nothing yet" in bpy.data.texts[engine.LOG_NAME].as_string()
    stand_in.append("die_at_start")
    said = refuses(bpy.ops.jghand.restart_engine)
    assert "stopped unexpectedly" in said
    assert "no torch here" in said
    assert state() == "failed"
    assert bpy.ops.jghand.show_log() == {"FINISHED"}
    assert "no torch here" in bpy.data.texts[engine.LOG_NAME].as_string()
    stand_in.clear()
    assert bpy.ops.jghand.restart_engine() == {"FINISHED"}
    assert bpy.ops.jghand.show_log() == {"FINISHED"}
    assert len(bpy.data.texts) == 1


def test_disabling_the_extension_ends_the_engine(stand_in):
    bpy.ops.jghand.restart_engine()
    process = runtime.link()._engine.popen
    runtime.unregister()
    assert process.poll() is not None


def test_another_file_does_not_end_the_engine(stand_in):
    bpy.ops.jghand.restart_engine()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert state() == "ready"


def test_the_tools_of_a_training_that_runs_are_not_taken_from_it(extension, monkeypatch):
    monkeypatch.setattr(runtime.jobs, "runs", lambda key: key == runtime.TRAINING)
    assert "in use" in refuses(bpy.ops.jghand.remove_tools)
    assert "in use" in refuses(bpy.ops.jghand.install_tools)


def draw_preferences(extension) -> RecordingLayout:
    class Page:
        layout = RecordingLayout()
        bl_rna = preferences.JGHandPreferences.bl_rna

    preferences.JGHandPreferences.draw(Page(), extension)
    return Page.layout


def test_the_preferences_say_how_the_engine_is_and_why_there_is_none(stand_in, extension, monkeypatch):
    assert "jghand.restart_engine" in draw_preferences(extension).operators
    bpy.ops.jghand.restart_engine()
    layout = draw_preferences(extension)
    assert "Ready" in layout.texts
    assert "jghand.restart_engine" in layout.operators
    runtime.use_link(None)
    monkeypatch.setenv(VARIABLE, "/nowhere/python")
    sentence = "The Python that JGHAND_ENGINE_PYTHON names does not exist"
    assert sentence in refuses(bpy.ops.jghand.restart_engine)
    texts = draw_preferences(extension).texts
    assert sentence in " ".join(texts)
    assert "/nowhere/python" in texts


def test_the_graphics_card_is_offered_where_the_engine_has_its_package(stand_in, extension, monkeypatch):
    asked = []
    monkeypatch.setattr(runtime, "engine_command", lambda *_, on_gpu, **__: asked.append(on_gpu))
    for chosen, on_gpu in (("AUTO", False), ("GPU", True)):
        monkeypatch.setattr(runtime, "preferences", lambda c=chosen: SimpleNamespace(render_device=c, engine_python=""))
        runtime.command()
        assert asked[-1] == on_gpu
    assert runtime.offers_graphics_card()  # nobody knows better before an engine runs
    bpy.ops.jghand.restart_engine()
    assert not runtime.offers_graphics_card()  # the stand-in names no capabilities
    monkeypatch.setitem(runtime.link().status.handshake, "capabilities", ["gpu"])
    assert runtime.offers_graphics_card()


def test_the_training_tools_are_asked_for_where_blender_may_go_online(extension, tmp_path, monkeypatch):
    monkeypatch.setattr(runtime, "tools_folder", lambda: tmp_path / "tools")
    monkeypatch.setattr(runtime, "is_online", lambda: False)
    assert runtime.tools_state() == "missing"
    assert "Online Access" in refuses(bpy.ops.jghand.install_tools)
    assert "no training tools" in refuses(bpy.ops.jghand.remove_tools)


def test_the_training_tools_are_made_mended_and_removed(extension, tmp_path, monkeypatch):
    folder = tmp_path / "tools"
    monkeypatch.setattr(runtime, "tools_folder", lambda: folder)
    monkeypatch.setattr(runtime, "TOOLS_PACKAGES", (str(_wheel(tmp_path)),))  # nothing is downloaded
    monkeypatch.setattr(runtime, "is_online", lambda: True)
    for _ in range(2):
        assert bpy.ops.jghand.install_tools() == {"FINISHED"}
        job = runtime.jobs.get(runtime.TOOLS)
        assert job.wait(120)
        assert job.state.failure is None, job.log
        assert runtime.tools_state() == "ready"
        python = str(install_tools.interpreter(folder))
        subprocess.run([python, "-I", "-c", "import jghand_engine, jghand_sample"], check=True)
        assert not (folder / "downloads").exists()
        (folder / install_tools.READY).unlink()
        assert runtime.tools_state() == "broken"
    assert "jghand.install_tools" in draw_preferences(extension).operators
    assert bpy.ops.jghand.remove_tools() == {"FINISHED"}
    assert runtime.tools_state() == "missing"


def _wheel(folder: Path) -> Path:
    """A package of one line."""
    about = "jghand_sample-1.0.dist-info"
    path = folder / "jghand_sample-1.0-py3-none-any.whl"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("jghand_sample.py", "there = True\n")
        archive.writestr(f"{about}/METADATA", "Metadata-Version: 2.1\nName: jghand_sample\nVersion: 1.0\n")
        archive.writestr(f"{about}/WHEEL", "Wheel-Version: 1.0\nRoot-Is-Purelib: true\nTag: py3-none-any\n")
        archive.writestr(f"{about}/RECORD", "")
    return path


def test_another_choice_of_python_starts_what_had_failed_anew(extension, stand_in_command):
    found: list[list[str]] = []

    def look() -> list[str]:
        if not found:
            raise JGHandFailure("no_interpreter")
        return found[0]

    runtime.use_link(EngineLink(look))
    assert "The renderer cannot be started" in refuses(bpy.ops.jghand.restart_engine)
    found.append(stand_in_command)
    runtime.look_again()
    runtime.link().wait_until_ready()
    assert state() == "ready"
