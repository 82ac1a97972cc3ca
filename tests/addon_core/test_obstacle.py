"""A folder in the way keeps others from writing a file, and leaves everything as it was."""

from __future__ import annotations

from pathlib import Path

import pytest

from blender_addon.render import obstacle


def everything_below(folder: Path) -> dict[str, bytes | None]:
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in folder.rglob("*")}


def test_nothing_can_be_written_where_an_obstacle_stands_and_all_is_as_before_afterwards(tmp_path):
    (tmp_path / "there.png").write_bytes(b"mine")
    before = everything_below(tmp_path)
    paths = [tmp_path / "there.png", tmp_path / "new.png", tmp_path / "Ünicode folder" / "below" / "new.png"]
    obstacles = obstacle.put([*paths, paths[0]])
    assert [each.path for each in obstacles] == paths
    for path in paths:
        with pytest.raises(OSError, match=path.name):
            path.write_bytes(b"not wanted")
    assert all(each.stands for each in obstacles)
    obstacle.take_away(obstacles)
    assert everything_below(tmp_path) == before


def test_a_folder_that_is_there_is_no_obstacle_of_ours(tmp_path):
    (tmp_path / "folder").mkdir()
    assert obstacle.put([tmp_path / "folder"]) == []


def test_where_none_can_be_put_nothing_is_changed(tmp_path):
    (tmp_path / "file").write_bytes(b"mine")
    before = everything_below(tmp_path)
    assert obstacle.put([tmp_path / "file" / "below.png"]) == []
    assert everything_below(tmp_path) == before


def test_a_file_that_cannot_be_put_aside_stays(tmp_path, monkeypatch):
    path = tmp_path / "open elsewhere.png"
    path.write_bytes(b"mine")

    def refused(*_: object) -> None:
        raise PermissionError(13, "in use")  # as Windows does it

    monkeypatch.setattr(Path, "rename", refused)
    assert obstacle.put([path]) == []
    assert path.read_bytes() == b"mine"


def test_what_others_put_below_an_obstacle_is_not_removed(tmp_path):
    obstacles = obstacle.put([tmp_path / "new" / "picture.png"])
    (tmp_path / "new" / "other.txt").write_bytes(b"mine")
    obstacle.take_away(obstacles)
    assert everything_below(tmp_path) == {"new": None, "new/other.txt": b"mine"}
