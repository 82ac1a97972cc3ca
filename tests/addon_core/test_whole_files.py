"""Files are written whole or not at all."""

from __future__ import annotations

from pathlib import Path

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


def test_a_copy_that_fails_leaves_what_was_there(tmp_path, monkeypatch):
    source, target = tmp_path / "new.usdc", tmp_path / "out.usdc"
    source.write_bytes(b"a new layer")
    target.write_bytes(b"the earlier layer")

    def full(_, path):
        Path(path).write_bytes(b"a new")
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(files.shutil, "copy2", full)
        with pytest.raises(JGHandFailure) as caught:
            files.copy_whole(source, target)
    assert caught.value.kind == "disk_full"
    assert target.read_bytes() == b"the earlier layer"
    files.copy_whole(source, target)
    assert target.read_bytes() == b"a new layer"
    assert {path.name for path in tmp_path.iterdir()} == {"new.usdc", "out.usdc"}


def test_a_folder_that_is_a_file_is_told(tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(JGHandFailure) as caught:
        files.write_whole(tmp_path / "out" / "0001.png", b"x")
    assert caught.value.kind == "cannot_write"
    assert "out" in caught.value.detail
