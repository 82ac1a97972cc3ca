"""The set-up of the two environments: which Python is taken, when is it quick, what does a failure say."""

import dataclasses
import os
import shutil
import sys
from pathlib import Path

import environments
import pytest
from environments import BLENDER, BLENDER45, ENGINE, MissingLibraryError, SetupError

THIS = sys.version_info[:2]
pytestmark = pytest.mark.skipif(os.name == "nt", reason="the stand-ins are shell scripts")


@pytest.fixture
def only_these_pythons(tmp_path, monkeypatch):
    """A machine whose PATH has only what the test puts into a folder, and no other place to look."""
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(environments.glob, "glob", lambda pattern: [])

    def add(name, output, code=0):
        script = tmp_path / name
        script.write_text(f"#!/bin/sh\necho '{output}'\nexit {code}\n")
        script.chmod(0o755)
        return [str(script)]

    return add


def test_the_python_that_runs_the_script_is_taken_when_it_will_do():
    assert environments.find_python((THIS,)) == [sys.executable]


def test_a_missing_python_is_named_with_a_way_to_get_it(only_these_pythons):
    with pytest.raises(SetupError, match=r"No usable Python 3\.98 or 3\.99 was found\. Install Python 3\.98"):
        environments.find_python(((3, 98), (3, 99)))


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """An environment in a project of its own. It is really made, but with an empty pip (the real one takes seconds),
    and steps of pip are only said."""
    (tmp_path / "constraints").mkdir()
    (tmp_path / "constraints/tiny.txt").write_text("# nothing\n")
    (tmp_path / "source.txt").write_text("one")
    monkeypatch.setattr(environments, "ROOT", tmp_path)
    monkeypatch.setattr(environments, "ENVIRONMENTS", tmp_path / ".envs")
    step = environments._step

    def without_pip(text, command, *, retry=False):
        if "venv" in command:
            step(text, [*command, "--without-pip"], retry=retry)
            folder = Path(command[-1]) / "lib" / f"python{THIS[0]}.{THIS[1]}" / "site-packages" / "pip"
            folder.mkdir()
            (folder / "__init__.py").touch()
        else:
            print(text, *command)

    monkeypatch.setattr(environments, "_step", without_pip)
    return environments.Environment("tiny", (THIS,), ("nothing",), ("*.txt",), builds=False, check="import sys")


def test_a_failing_step_shows_the_end_of_what_it_said_and_its_command(capsys):
    command = [sys.executable, "-c", "import sys; print('the reason'); sys.exit(1)"]
    with pytest.raises(SetupError, match=r"This step failed: trying\.\nthe reason\n(.*\n)*The command was: "):
        environments._step("trying", command, retry=True)
    assert capsys.readouterr().out.count("once more") == 1


def test_an_environment_is_made_once_and_again_when_its_sources_change(tiny, capsys, tmp_path):
    python = environments.ensure(tiny)
    assert python.exists()
    assert "Setting up" in capsys.readouterr().out
    environments.ensure(tiny)
    assert capsys.readouterr().out == ""
    (tmp_path / "source.txt").write_text("two")
    environments.ensure(tiny)
    assert "installing" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("lost", "said"),
    [
        ((environments.STAMP,), "installing the packages"),
        (("**/bin/python", "**/python.exe"), "unfinished"),
        ((environments.STAMP, "**/site-packages/pip"), "unfinished"),
    ],
    ids=["packages", "python", "pip"],
)
def test_an_environment_that_lacks_something_is_finished_or_made_anew(tiny, capsys, lost, said):
    environments.ensure(tiny)
    for path in [path for name in lost for path in tiny.folder.glob(name)]:
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    capsys.readouterr()
    environments.ensure(tiny)
    assert said in capsys.readouterr().out


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the hint is for Linux")
def test_a_missing_system_library_is_named_with_the_line_that_installs_it(tiny):
    check = "raise ImportError('libGL.so.1: cannot open shared object file: No such file or directory')"
    with pytest.raises(MissingLibraryError, match=r"libGL\.so\.1.*(\n.*)*apt-get install -y libgl1"):
        environments.ensure(dataclasses.replace(tiny, check=check))


@pytest.mark.parametrize("environment", [ENGINE, BLENDER, BLENDER45])
def test_every_constraint_is_one_exact_public_version(environment):
    lines = [line for line in environment.constraints.read_text().splitlines() if line and not line.startswith("#")]
    assert lines
    for line in lines:
        requirement = line.split(";")[0].strip()
        name, _, version = requirement.partition("==")
        assert name, line
        assert version, line
        assert "+" not in version, f"{line}: a local version is not on every index"
