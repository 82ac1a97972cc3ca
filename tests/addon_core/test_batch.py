"""Frames, names and files of a batch run."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from blender_addon.errors import JGHandFailure
from blender_addon.render import batch


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("7", [7]),
        ("1-4", [1, 2, 3, 4]),
        ("1-10,4", [1, 5, 9]),
        ("-2-1", [-2, -1, 0, 1]),
        ("-3--1", [-3, -2, -1]),
        ("0-0", [0]),
    ],
)
def test_frames_are_read(text, frames):
    assert batch.parse_frames(text) == frames


@pytest.mark.parametrize("text", ["", "a", "1-", "4-1", "1-4,0", "1-4,-1", "1,2,3", "1.5", "1-4 "])
def test_frames_that_make_no_sense_are_refused(text):
    with pytest.raises(ValueError, match="frames"):
        batch.parse_frames(text)


@pytest.mark.parametrize(
    ("camera", "folder"),
    [("CamPalm", "CamPalm"), ("a/b:c", "a_b_c"), ("..", "camera"), ("Kamera äußen", "Kamera äußen")],
)
def test_pictures_lie_below_the_folder_whatever_a_camera_is_called(camera, folder, tmp_path):
    assert batch.picture_path(tmp_path, camera, 7) == tmp_path / folder / "0007.png"


def test_cameras_that_would_share_a_folder_are_refused(tmp_path):
    batch.check_folders(tmp_path, ["a", "b", "a.b"])
    for first, second in (("a/b", "a:b"), ("Cam", "cam"), ("..", "")):
        with pytest.raises(JGHandFailure, match="folder") as caught:
            batch.check_folders(tmp_path, ["other", first, second])
        assert caught.value.detail == f"{first} and {second}"


def test_a_file_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    target = tmp_path / "new" / "0001.png"
    batch.write_whole(target, b"first")
    monkeypatch.setattr(batch.os, "fsync", lambda _: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(JGHandFailure) as caught:
        batch.write_whole(target, b"second")
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
        patch.setattr(batch.shutil, "copy2", full)
        with pytest.raises(JGHandFailure) as caught:
            batch.copy_whole(source, target)
    assert caught.value.kind == "disk_full"
    assert target.read_bytes() == b"the earlier layer"
    batch.copy_whole(source, target)
    assert target.read_bytes() == b"a new layer"
    assert {path.name for path in tmp_path.iterdir()} == {"new.usdc", "out.usdc"}


def test_two_copies_to_one_place_at_a_time_do_not_mix(tmp_path, monkeypatch):
    """As two Blenders that export into one folder make them."""
    sources, target, copy2 = [tmp_path / name for name in ("a.usdc", "b.usdc")], tmp_path / "out.usdc", shutil.copy2
    for source in sources:
        source.write_bytes(source.name.encode())

    def slowly(source, path):
        copy2(source, path)
        if source == sources[0]:
            batch.copy_whole(sources[1], target)
            assert Path(path).read_bytes() == b"a.usdc", "nobody wrote into it"

    monkeypatch.setattr(batch.shutil, "copy2", slowly)
    batch.copy_whole(sources[0], target)
    assert target.read_bytes() == b"a.usdc"
    assert {path.name for path in tmp_path.iterdir()} == {"a.usdc", "b.usdc", "out.usdc"}


def test_a_folder_that_is_a_file_is_told(tmp_path):
    (tmp_path / "out").touch()
    with pytest.raises(JGHandFailure) as caught:
        batch.write_whole(tmp_path / "out" / "0001.png", b"x")
    assert caught.value.kind == "cannot_write"
    assert "out" in caught.value.detail


def test_the_report_counts_what_was_done_and_says_what_failed(tmp_path):
    report = batch.BatchReport("hand.blend", "final", total=3)
    assert "1 of 3" in report.skipped("Cam", 1, tmp_path / "0001.png")
    assert "2 of 3" in report.rendered("Cam", 2, tmp_path / "0002.png", batch.PictureTimes(1, 5, 3), {"size": [4, 3]})
    report.failed(JGHandFailure("crashed", "exit code 7"))
    content = json.loads(report.as_json())
    assert (content["wanted"], content["rendered"], content["skipped"]) == (3, 1, 1)
    assert content["failure"]["kind"] == "crashed"
    picture = content["pictures"][1]
    assert picture["size"] == [4, 3]
    times = {name: picture[name] for name in ("milliseconds", "evaluate_ms", "request_ms", "write_ms")}
    assert times == {"milliseconds": 8, "evaluate_ms": 1, "request_ms": 5, "write_ms": 3}
