"""Other programs on Windows, macOS and Linux: the decisions, tried here for all three."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from blender_addon.core import files, limits
from blender_addon.export.recording import file_names
from blender_addon.renderer import engine_command, programs
from blender_addon.renderer.engine_command import engine_program

posix = pytest.mark.skipif(os.name == "nt", reason="paths are written as POSIX has them")


def touch(path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.touch(mode=0o755)
    return path


@posix
@pytest.mark.parametrize("inside", ["bin/python", "Scripts/python.exe", "python.exe"])
def test_the_folder_of_an_environment_means_its_python_and_quotation_marks_mean_nothing(tmp_path, inside):
    python = touch(tmp_path / "my environment" / inside)
    for text in (str(python), f'"{python}"', f" {python}\n", str(tmp_path / "my environment")):
        assert programs.interpreter_at(text) == python
    assert engine_program(f'"{python}"', environment={})[0] == str(python)
    assert programs.interpreter_at("~/my environment", str(tmp_path)) == python
    assert programs.interpreter_at("/nowhere/python") == Path("/nowhere/python")


def test_a_command_for_a_terminal_is_one_that_its_shell_takes():
    plain = [r"C:\engine\python.exe", "-m", "pip", "install", "."]
    assert programs.in_terminal(plain, "win32") == r"C:\engine\python.exe -m pip install ."
    spaced = [r"C:\Program Files\python.exe", "-m", "pip", "install", r"D:\my files"]
    # PowerShell takes a quoted first word for a text
    assert programs.in_terminal(spaced, "win32") == r'& "C:\Program Files\python.exe" -m pip install "D:\my files"'
    assert programs.in_terminal(["/my files/python", "-m", "pip"], "linux") == '"/my files/python" -m pip'


def test_on_windows_a_job_is_ended_with_all_that_it_has_started_and_no_window_flashes(monkeypatch):
    called = []
    process = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    monkeypatch.setenv("SYSTEMROOT", r"D:\Windows")
    monkeypatch.setattr(programs, "HIDDEN", 0x08000000)
    monkeypatch.setattr(programs.subprocess, "run", lambda words, **options: called.append((words, options)))
    programs.end_tree(process, at_once=False, platform="win32")
    assert process.wait(10) != 0  # also where taskkill does nothing
    ((words, options),) = called
    assert words == [r"D:\Windows\System32\taskkill.exe", "/F", "/T", "/PID", str(process.pid)]
    assert options["creationflags"] == 0x08000000
    assert options["timeout"] <= limits.KILL_S


def test_every_process_of_the_extension_is_started_without_a_window():
    for path in (Path(programs.__file__).parent).rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        starts = text.count("subprocess.Popen(") + text.count("subprocess.run(")
        assert text.count("creationflags=HIDDEN") == starts, path


def test_on_windows_a_file_that_a_virus_scanner_reads_is_replaced_a_moment_later(tmp_path, monkeypatch):
    path, refused, replace = tmp_path / "stamp.json", [3], os.replace

    def busy(source: Path, target: Path) -> None:
        if refused[0]:
            refused[0] -= 1
            raise PermissionError(errno.EACCES, "in use")
        replace(source, target)

    monkeypatch.setattr(files.os, "replace", busy)
    monkeypatch.setattr(limits, "REPLACE_RESTS_S", (0.0,) * 4)
    monkeypatch.setattr(files.sys, "platform", "win32")
    files.write_whole(path, b"whole")
    assert path.read_bytes() == b"whole"
    assert list(tmp_path.iterdir()) == [path]


def test_no_file_has_a_name_that_windows_keeps_for_a_device():
    assert file_names(["CON", "nul", "com1", "Console", "com10"]) == ["CON_", "nul_", "com1_", "Console", "com10"]


def test_the_interpreters_of_all_systems_are_looked_for_in_a_checkout():
    assert {"bin/python", "Scripts/python.exe"} <= set(engine_command._INTERPRETERS)
