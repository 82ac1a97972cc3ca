"""The finished avatar: written over the training's own work, never over another's, whenever a process is killed."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import numpy as np
import pytest

from jghand_engine import files
from jghand_engine.avatar.builtin import load_painted
from jghand_engine.avatar.file import load_avatar
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.work_folder import Output


@pytest.fixture(scope="module")
def avatars():
    """Two of 20 Gaussians that differ."""
    first = load_painted(handedness=Handedness.RIGHT).prefix(20)
    return first, replace(first, opacity=first.opacity * 0.5)


class Killed(BaseException):
    """The end of a process: nothing below it can go on."""


@pytest.fixture
def killed_at(monkeypatch):
    """Kills at the n-th rename, just before or just after it; only renames change what others see."""
    rename = os.replace

    def prepare(number: int, *, after: bool) -> None:
        done = iter(range(100))

        def replacing(source, target):
            here = next(done) == number
            if not here or after:
                rename(source, target)
            if here:
                raise Killed

        monkeypatch.setattr(files.os, "replace", replacing)

    yield prepare
    monkeypatch.setattr(files.os, "replace", rename)


@pytest.mark.parametrize("there_before", [False, True])
@pytest.mark.parametrize("after", [False, True])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_killed_at_any_moment_a_training_still_knows_its_own_file(
    tmp_path, avatars, killed_at, monkeypatch, number, after, there_before
):
    def output() -> Output:
        return Output(tmp_path / "hand.jghand", tmp_path / "work" / "output.json")

    first, second = avatars
    if there_before:
        output().write(first)
    killed_at(number, after=after)
    with pytest.raises(Killed):
        output().write(second)
    monkeypatch.undo()
    output().check()
    output().write(second)
    assert np.array_equal(load_avatar(tmp_path / "hand.jghand").opacity, load_avatar_of(second, tmp_path).opacity)
    assert sorted(path.name for path in (tmp_path / "work").iterdir()) == ["output.json"]


def load_avatar_of(avatar, folder):
    other = Output(folder / "other.jghand", folder / "other" / "output.json")
    other.write(avatar)
    return load_avatar(other.path)


def test_a_file_of_somebody_else_is_never_replaced(tmp_path, avatars):
    output = Output(tmp_path / "hand.jghand", tmp_path / "output.json")
    output.write(avatars[0])
    output.path.write_bytes(b"mine")
    with pytest.raises(InputError, match="--overwrite"):
        output.write(avatars[1])
    assert output.path.read_bytes() == b"mine"


def test_a_record_of_an_older_jghand_is_understood(tmp_path, avatars):
    output = Output(tmp_path / "hand.jghand", tmp_path / "output.json")
    output.write(avatars[0])
    newest = json.loads((tmp_path / "output.json").read_text())["sha256"][0]
    (tmp_path / "output.json").write_text(json.dumps({"sha256": newest}))
    output.check()
