"""The check says which engine there is, what is wrong with it, and the one thing that mends it."""

from __future__ import annotations

import json
import os
import sys
import time
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "scripts"))

import environments

from blender_addon.core import limits
from blender_addon.core.wire import protocol
from blender_addon.errors import JGHandFailure
from blender_addon.renderer import engine_check, engine_command
from blender_addon.renderer.engine_check import CheckResult, EngineCheck
from blender_addon.renderer.engine_command import NOTE, FoundEngine, find_engine, note_folder

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
WHOLE = {
    **{"python": "3.12.1", "engine": "0.1.0", "protocol": protocol.PROTOCOL_VERSION, "kernels": "v4"},
    **{"packages": {"torch": "2.9"}, "missing": [], "broken": {}},
}
posix = pytest.mark.skipif(os.name == "nt", reason="the stand-in is a shell script")


def checked(tmp_path: Path, script: str, checkout: Path | None = None, **options) -> CheckResult:
    """The result for a Python that is a shell script."""
    python = tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{script}\n")
    python.chmod(0o755)
    check = EngineCheck(lambda: find_engine(str(python)), checkout=checkout, **options)
    result = check.wait(PATIENCE_S)
    assert result is not None
    assert check.over
    return result


def says(**facts: object) -> str:
    return f"echo a library says hello; cat <<'END'\nJGHAND CHECK {json.dumps({**WHOLE, **facts})}\nEND"


def values(result: CheckResult, *, good: bool | None = None) -> dict[str, str]:
    return {found.label: found.value for found in result.findings if good is None or found.good is good}


@posix
def test_a_whole_engine_is_good_and_needs_nothing(tmp_path):
    result = checked(tmp_path, says())
    assert result.good
    assert (result.failure, result.mend, result.remedy, values(result, good=False)) == ("", "", "", {})
    assert values(result)["Found by"] == "The Python that was chosen"
    assert values(result)["Path"] == str(tmp_path / "python")
    assert values(result)["Engine"] == f"0.1.0, protocol {protocol.PROTOCOL_VERSION}"


@posix
def test_a_python_without_the_engine_is_mended_by_pip(tmp_path):
    facts = {"missing": ["torch", "rich"]}
    bare = {name: value for name, value in WHOLE.items() if name not in ("engine", "protocol", "kernels")}
    result = checked(tmp_path, f"cat <<'END'\nJGHAND CHECK {json.dumps({**bare, **facts})}\nEND")
    assert result.failure == "no_engine"
    assert result.mend == f"{tmp_path / 'python'} -m pip install ."
    assert result.where == "JGHand's folder"
    assert values(result, good=False) == {"Engine": "not installed", "Missing": "torch, rich"}


@posix
def test_where_the_folder_is_known_the_command_names_it(tmp_path):
    (tmp_path / "pyproject.toml").touch()
    result = checked(tmp_path, says(missing=["torch"]), checkout=tmp_path)
    assert result.failure == "broken_engine"
    assert (result.mend, result.where) == (f"{tmp_path / 'python'} -m pip install {tmp_path}", "")
    assert "torch is missing" in result.detail


@posix
def test_a_package_that_does_not_load_is_told_with_its_reason(tmp_path):
    result = checked(tmp_path, says(broken={"torch": "libcudart.so: not found"}))
    assert result.failure == "broken_engine"
    assert "libcudart.so" in result.detail
    assert values(result, good=False) == {"Broken": "torch"}


@posix
@pytest.mark.parametrize(("change", "word", "mends"), [(1, "newer extension", False), (-1, "update the engine", True)])
def test_another_version_is_told_with_which_side_is_older(tmp_path, change, word, mends):
    result = checked(tmp_path, says(protocol=protocol.PROTOCOL_VERSION + change))
    assert result.failure == "protocol"
    assert word in result.detail
    assert bool(result.mend) == mends


@posix
def test_slow_drawing_is_told_and_is_no_failure(tmp_path):
    result = checked(tmp_path, says(kernels=""))
    assert result.good
    assert "slow" in values(result, good=False)["Drawing"]


@posix
def test_an_old_python_is_told(tmp_path):
    assert values(checked(tmp_path, says(python="3.9.2")), good=False) == {"Python": "3.9.2"}


@posix
@pytest.mark.parametrize("script", ["exit 3", "echo hello", "kill -SEGV $$", "echo JGHAND; exit 1"])
def test_a_python_that_does_not_answer_is_told_with_its_last_words(tmp_path, script):
    result = checked(tmp_path, f"echo the last words >&2\n{script}")
    assert result.failure == "crashed"
    assert "the last words" in result.detail


@posix
def test_a_python_that_hangs_is_given_up(tmp_path):
    result = checked(tmp_path, "exec sleep 600", timeout_s=0.3)
    assert result.failure == "start_timeout"


def test_what_is_no_program_is_told(tmp_path):
    (tmp_path / "python").write_text("no program")
    check = EngineCheck(lambda: find_engine(str(tmp_path / "python")))
    assert check.wait(PATIENCE_S).failure == "no_interpreter"


@posix
def test_a_check_can_be_ended(tmp_path):
    python = tmp_path / "python"
    python.write_text("#!/bin/sh\nexec sleep 600\n")
    python.chmod(0o755)
    check = EngineCheck(lambda: find_engine(str(python)))
    while check._process is None and not check.over:
        time.sleep(0.01)
    check.close()
    assert check.wait(PATIENCE_S) is None
    assert check.over
    assert check._process.poll() is not None


def test_no_engine_at_all_is_mended_by_the_scripts():
    check = EngineCheck(lambda: find_engine(environment={"PATH": ""}), checkout=ROOT)
    assert check.over
    result = check.wait(0.0)
    assert result.failure == "no_interpreter"
    assert result.mend == f'{engine_check._ANY_PYTHON} "{ROOT / "scripts/test.py"}" --only checks'
    assert Path(result.mend.split('"')[1]).is_file()
    assert result.remedy == "Choose the engine's Python"


def test_a_command_without_a_python_beside_it_is_told_to_be_unknown(tmp_path):
    found = FoundEngine("The command jghand on the PATH", (str(tmp_path / "jghand"),), None)
    result = EngineCheck(lambda: found).wait(PATIENCE_S)
    assert not result.good
    assert "not known" in result.sentence
    assert "start the engine" in values(result, good=False)["Python"]


@posix
def test_the_command_on_the_path_leads_to_the_python_of_its_environment(tmp_path):
    bin_folder, links = tmp_path / "env" / "bin", tmp_path / "links"
    bin_folder.mkdir(parents=True)
    links.mkdir()
    (tmp_path / "env" / "pyvenv.cfg").touch()
    for name in ("python", "jghand"):
        (bin_folder / name).touch(mode=0o755)
    (links / "jghand").symlink_to(bin_folder / "jghand")
    found = find_engine(environment={"PATH": str(links)})
    assert found.program == (str(links / "jghand"),)
    assert found.python == str(bin_folder / "python")


@posix
@pytest.mark.parametrize("begin", ["#!{}\n", "#! {} -sE\n", "#!/bin/sh\n'''exec' \"{}\" \"$0\" \"$@\"\n' '''\n"])
def test_a_command_somewhere_leads_to_the_python_that_it_names(tmp_path, begin):
    python, script = tmp_path / "a b" / "python3.12", tmp_path / "jghand"
    if " -sE" in begin or begin == "#!{}\n":
        python = tmp_path / "python3.12"
    python.parent.mkdir(exist_ok=True)
    python.touch(mode=0o755)
    script.write_text(begin.format(python))
    script.chmod(0o755)
    assert find_engine(environment={"PATH": str(tmp_path)}).python == str(python)


@posix
@pytest.mark.parametrize("content", ["", "#!/usr/bin/env python3\n", "#!/nowhere/python3\n", "\0MZ"])
def test_a_command_that_names_no_python_is_not_guessed_at(tmp_path, content):
    script = tmp_path / "jghand"
    script.write_text(content)
    script.chmod(0o755)
    assert find_engine(environment={"PATH": str(tmp_path)}).python is None


@pytest.mark.parametrize(("command", "python"), [("bin/jghand", "bin/python"), ("Scripts/jghand.exe", "python.exe")])
def test_the_python_of_a_conda_environment_is_found(tmp_path, command, python):
    for name in (command, python):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch(mode=0o755)
    (tmp_path / "conda-meta").mkdir()
    assert engine_command._python_of(str(tmp_path / command)) == str(tmp_path / python)


def test_a_search_that_fails_is_told():
    def find() -> FoundEngine:
        raise PermissionError("somebody else's")

    result = EngineCheck(find).wait(0.0)
    assert result.failure == "no_interpreter"
    assert "somebody else's" in result.detail


def test_a_chosen_python_that_may_not_be_looked_at_is_told(monkeypatch):
    def exists(_: Path) -> bool:
        raise PermissionError

    monkeypatch.setattr(Path, "exists", exists)
    with pytest.raises(JGHandFailure) as caught:
        find_engine("/root/python")
    assert caught.value.kind == "no_interpreter"


def test_the_extension_finds_what_the_scripts_made(tmp_path, monkeypatch):
    python = tmp_path / ".envs" / "engine" / environments.ENGINE.python.relative_to(environments.ENGINE.folder)
    python.parent.mkdir(parents=True)
    python.touch()
    monkeypatch.setattr(environments, "ENVIRONMENTS", tmp_path / ".envs")
    monkeypatch.setenv("JGHAND_CONFIG_DIR", str(tmp_path / "config"))
    environments._note(environments.BLENDER)
    assert not (tmp_path / "config").exists()
    environments._note(environments.ENGINE)
    assert (tmp_path / "config" / NOTE).is_file()
    environment = {"PATH": "", "JGHAND_CONFIG_DIR": str(tmp_path / "config")}
    found = find_engine(environment=environment)
    assert (found.python, found.origin) == (str(python), "The environment that JGHand's scripts made")
    python.unlink()
    assert "Engine" in values(EngineCheck(lambda: find_engine(environment=environment)).wait(0.0), good=False)


@pytest.mark.parametrize("platform", ["linux", "darwin", "win32"])
def test_both_sides_look_in_the_same_folder(platform, monkeypatch, tmp_path):
    monkeypatch.delenv("JGHAND_CONFIG_DIR", raising=False)
    monkeypatch.setattr(environments.sys, "platform", platform)
    for variables in ({}, {"HOME": str(tmp_path)}, {"HOME": "h", "XDG_CONFIG_HOME": "x"}, {"LOCALAPPDATA": "l"}):
        for name in ("HOME", "XDG_CONFIG_HOME", "LOCALAPPDATA"):
            monkeypatch.delenv(name, raising=False)
        for name, value in variables.items():
            monkeypatch.setenv(name, value)
        assert note_folder(os.environ, platform) == environments.note_folder()


def test_the_engine_that_runs_the_tests_is_found_whole():
    pytest.importorskip("torch")
    result = EngineCheck(lambda: find_engine(sys.executable), timeout_s=limits.CHECK_S).wait(PATIENCE_S)
    assert result.good, result
    assert {"Python", "Engine", "PyTorch", "Drawing"} <= values(result).keys()
