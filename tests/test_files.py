"""Files are written whole or not at all."""

import errno
import os
from pathlib import Path

import pytest

from jghand_engine.errors import InputError, RetryError
from jghand_engine.files import make_folder, writing


def test_a_finished_file_appears_under_its_name_and_nothing_else_stays(tmp_path: Path) -> None:
    with writing(tmp_path / "sub" / "a.txt") as temporary:
        temporary.write_text("whole")
        assert temporary.suffix == ".txt", "writers choose their format by the suffix"
    assert (tmp_path / "sub" / "a.txt").read_text() == "whole"
    assert [p.name for p in (tmp_path / "sub").iterdir()] == ["a.txt"]


def test_a_failure_while_writing_leaves_the_old_file_and_no_rest(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(ZeroDivisionError), writing(target) as temporary:
        temporary.write_text("half")
        raise ZeroDivisionError
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_full_disk_asks_to_try_again_and_leaves_the_old_file(tmp_path: Path) -> None:
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RetryError, match="disk is full"), writing(target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "in_the_way").write_text("")
    with pytest.raises(InputError, match="in_the_way"):
        make_folder(tmp_path / "in_the_way" / "out")


def test_finished_files_have_the_usual_rights(tmp_path: Path) -> None:
    with writing(tmp_path / "a.txt") as temporary:
        temporary.write_text("")
    plain = tmp_path / "b.txt"
    plain.write_text("")
    assert (tmp_path / "a.txt").stat().st_mode == plain.stat().st_mode
