"""Where a real Blender is run: on this machine, in a folder of its own, or not at all, with the reason."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import blender_folder
import pytest
import test_in_blender as script
from blender_folder import NotPossibleError, Place

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="a virtual screen needs Linux")


@pytest.fixture
def programs(monkeypatch):
    """A machine that has only the named programs."""

    def only(*names: str) -> None:
        monkeypatch.setattr(blender_folder.shutil, "which", lambda name: f"/bin/{name}" if name in names else None)

    return only


def test_a_machine_that_has_everything_needs_no_folder(programs, tmp_path):
    programs(*blender_folder.PROGRAMS)
    assert blender_folder.find_place(tmp_path / "folder") == Place(None)
    assert not (tmp_path / "folder").exists()


def test_without_root_it_is_said_what_is_missing(programs, monkeypatch, tmp_path):
    programs("import")
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    with pytest.raises(NotPossibleError, match="needs root"):
        blender_folder.find_place(tmp_path)


def test_without_mounts_and_without_the_builder_it_is_said_too(programs, monkeypatch, tmp_path):
    programs()
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    answer = subprocess.CompletedProcess((), 1)
    monkeypatch.setattr(blender_folder.subprocess, "run", lambda *_, **__: answer)
    with pytest.raises(NotPossibleError, match="does not allow mounts"):
        blender_folder.find_place(tmp_path / "folder")
    answer.returncode = 0
    with pytest.raises(NotPossibleError, match="mmdebstrap is not installed"):
        blender_folder.find_place(tmp_path / "folder")


def test_a_folder_that_broke_off_is_neither_used_nor_deleted(programs, monkeypatch, tmp_path):
    programs("mmdebstrap")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    unfinished = tmp_path / "folder.unfinished"
    (unfinished / "dev").mkdir(parents=True)
    with pytest.raises(NotPossibleError, match="broke off"):
        blender_folder.make_folder(tmp_path / "folder")
    assert (unfinished / "dev").is_dir()


def test_on_this_machine_a_command_sees_only_the_variables_that_it_is_given(monkeypatch):
    monkeypatch.setenv("SECRET", "1")
    command = Place(None).command(["env"], [], {"HOME": "/nowhere"})
    said = subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()
    assert {line.partition("=")[0] for line in said} <= {"PATH", "LANG", "HOME", "PWD", "SHLVL", "_"}
    assert "HOME=/nowhere" in said


def test_names_with_spaces_and_quotes_reach_the_folder_whole(tmp_path):
    command = Place(Path("/the folder's")).command(["blender", "a b"], [tmp_path], {"HOME": "it's"})
    assert command[-3:] == ["HOME=it's", "blender", "a b"]
    (mounts,) = [word for word in command if "mount --bind" in word]
    check = subprocess.run(["bash", "-n", "-c", mounts], capture_output=True, text=True, check=False)
    assert check.returncode == 0, check.stderr
    assert f"mount --bind {tmp_path}" in mounts


def test_an_unknown_story_names_those_that_there_are(capsys, monkeypatch):
    monkeypatch.setattr(sys, "argv", ["test_in_blender.py", "nothing"])
    assert script.main() == script.CANNOT
    said = capsys.readouterr().out
    assert "there is no story nothing" in said
    for name in ("animator", "trouble", "viewport", "readme"):
        assert name in said


def test_every_story_has_steps_and_no_helper_is_taken_for_one():
    for name in script.stories():
        assert "def step_" in (script.STORIES / f"{name}.py").read_text(encoding="utf-8"), name
