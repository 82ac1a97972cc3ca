"""A folder's pictures are all made from the same things, or no run goes on among them."""

from __future__ import annotations

from pathlib import Path

import pytest

from blender_addon.errors import JGHandFailure
from blender_addon.render import stamp

ONE, OTHER = {"file": "a", "preset": "final"}, {"file": "a", "preset": "draft"}


def pictures(folder: Path, *frames: int) -> list[Path]:
    folder.mkdir(exist_ok=True)
    paths = [folder / f"{frame:04d}.png" for frame in frames]
    for path in paths:
        path.touch()
    return paths


def settles(folder: Path, made_from: dict, replaced: list[Path] | None = None) -> bool:
    """False when the folder holds other pictures."""
    try:
        stamp.settle(folder, made_from, replaced)
    except JGHandFailure as failure:
        if failure.kind != "other_pictures":
            raise
        return False
    return True


def test_a_new_folder_is_stamped_and_taken_by_runs_of_the_same_only(tmp_path):
    assert settles(tmp_path / "new", ONE)
    pictures(tmp_path / "new", 1)
    assert settles(tmp_path / "new", ONE)
    with pytest.raises(JGHandFailure, match="another preset"):
        stamp.settle(tmp_path / "new", OTHER)


def test_a_folder_without_pictures_may_change_its_stamp(tmp_path):
    assert settles(tmp_path, ONE)
    (tmp_path / "notes.png").touch()  # not one of ours
    assert settles(tmp_path, OTHER)


@pytest.mark.parametrize("content", [None, b"", b"[]", b"\xff"])
def test_pictures_of_unknown_origin_are_nobodys(tmp_path, content):
    pictures(tmp_path, -2)
    if content is not None:
        (tmp_path / stamp.NAME).write_bytes(content)
    assert not settles(tmp_path, ONE)


def test_a_run_that_replaces_all_removes_them_so_that_it_can_be_cut_off_and_go_on(tmp_path):
    settles(tmp_path, ONE)
    old = pictures(tmp_path, 1, 2)
    assert settles(tmp_path, OTHER, old)
    assert not any(path.exists() for path in old)
    assert settles(tmp_path, OTHER)


@pytest.mark.parametrize("again", [1, 7])
def test_a_run_that_replaces_some_leaves_a_mixture_that_nobody_goes_on_with(tmp_path, again):
    settles(tmp_path, ONE)
    pictures(tmp_path, 1, 2)
    assert settles(tmp_path, OTHER, [tmp_path / f"{again:04d}.png"])
    assert (tmp_path / "0002.png").exists()
    pictures(tmp_path, again)
    for made_from in (ONE, OTHER):
        assert not settles(tmp_path, made_from)


def test_a_run_that_replaces_pictures_of_the_same_removes_none(tmp_path):
    settles(tmp_path, ONE)
    (picture,) = pictures(tmp_path, 1)
    assert settles(tmp_path, ONE, [picture])
    assert picture.exists()


def test_a_hash_is_of_the_contents(tmp_path):
    first, second = tmp_path / "a", tmp_path / "b"
    first.write_bytes(b"x")
    second.write_bytes(b"x")
    assert stamp.digest([first]) == stamp.digest([second]) != stamp.digest([first, second])
    with pytest.raises(JGHandFailure):
        stamp.digest([tmp_path / "nothing"])
