"""Files are written whole or not at all."""

import pytest

from blender_addon.core import files
from blender_addon.errors import JGHandFailure


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    target = tmp_path / "new" / "0001.png"
    files.write_whole(target, b"first")
    monkeypatch.setattr(files.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(JGHandFailure) as caught:
        files.write_whole(target, b"second")
    assert caught.value.kind == "disk_full"
    assert caught.value.advice.exit_code == 3
    assert target.read_bytes() == b"first"
    assert list(target.parent.iterdir()) == [target]


def test_a_folder_that_is_a_file_is_told(tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(JGHandFailure) as caught:
        files.write_whole(tmp_path / "out" / "0001.png", b"x")
    assert caught.value.kind == "cannot_write"
    assert "out" in caught.value.detail
