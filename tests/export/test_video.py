"""MP4 through a separate ffmpeg process."""

import sys

import numpy as np
import pytest

from jghand_engine.cli import main
from jghand_engine.errors import InputError, RetryError
from jghand_engine.export import video
from jghand_engine.export.video import padded_to_even, refuse_foreign_video, write_video

imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")


def decoded(path):
    """All pictures of a video and what its header says."""
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    width, height = meta["size"]
    return meta, [np.frombuffer(data, np.uint8).reshape(height, width, 3) for data in reader]


def moving_square(count, height=48, width=64):
    for index in range(count):
        picture = np.full((height, width, 3), (180, 140, 120), np.uint8)
        picture[16:32, 4 * index : 4 * index + 16] = (40, 60, 200)
        yield picture


def test_video_holds_the_pictures_at_the_given_rate(tmp_path):
    path = tmp_path / "hand.mp4"
    assert write_video(path, moving_square(8), 30) == 8
    meta, pictures = decoded(path)
    assert meta["codec"].startswith("h264")
    assert meta["pix_fmt"].startswith("yuv420p")
    assert meta["fps"] == 30
    assert len(pictures) == 8
    errors = [np.abs(a.astype(int) - b).mean() for a, b in zip(pictures, moving_square(8), strict=True)]
    assert max(errors) < 3, "worst seen 2.1 of 255, mostly the halved color resolution at the edges"


def test_flat_color_keeps_its_value_through_the_video(tmp_path):
    color = (201, 153, 122)
    write_video(tmp_path / "flat.mp4", (np.full((64, 64, 3), color, np.uint8) for _ in range(3)), 24)
    _, pictures = decoded(tmp_path / "flat.mp4")
    assert np.abs(pictures[1].astype(int) - color).max() <= 3, "worst seen 2: 8-bit YUV"


def test_odd_sizes_are_padded_with_the_border(tmp_path):
    picture = np.arange(5 * 7 * 3, dtype=np.uint8).reshape(5, 7, 3)
    padded = padded_to_even(picture)
    assert padded.shape == (6, 8, 3)
    assert (padded[:5, :7] == picture).all()
    assert (padded[5, :7] == picture[4]).all()
    write_video(tmp_path / "odd.mp4", [np.full((33, 47, 3), 90, np.uint8)] * 2, 25)
    assert decoded(tmp_path / "odd.mp4")[0]["size"] == (48, 34)


@pytest.mark.parametrize("name", ["a.gif", "a.mov", "a.webm", "a"])
def test_a_video_that_would_not_be_what_its_name_says_is_refused_before_anything_is_drawn(tmp_path, capsys, name):
    words = ["render", "--poses", "open", "--frames", "0", "--size", "32x24", "--out", str(tmp_path / "out")]
    assert main([*words, "--video", str(tmp_path / name)]) == 2
    assert "a name that ends in .mp4" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_failing_picture_source_leaves_no_file_and_its_own_error(tmp_path):
    def pictures():
        yield np.zeros((16, 16, 3), np.uint8)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_video(tmp_path / "broken.mp4", pictures(), 30)
    assert not list(tmp_path.iterdir())


def test_a_missing_extra_is_named_with_its_remedy(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(InputError, match=r"jghand\[video\]"):
        write_video(tmp_path / "x.mp4", moving_square(2), 30)


@pytest.mark.skipif(sys.platform == "win32", reason="the stand-in is a shell script")
@pytest.mark.parametrize("said", ["Unknown encoder 'libx264'", "No space left on device"])
def test_a_failing_ffmpeg_is_reported_with_what_it_said(tmp_path, monkeypatch, said):
    program = tmp_path / "ffmpeg"
    program.write_text(f'#!/bin/sh\necho "{said}" >&2\nexit 1\n')
    program.chmod(0o755)
    monkeypatch.setattr(video, "ffmpeg_program", lambda: str(program))
    with pytest.raises(RetryError, match="disk is full" if "space" in said else said):
        write_video(tmp_path / "out" / "x.mp4", moving_square(200, 400, 900), 30)
    assert not list((tmp_path / "out").iterdir())


def test_a_film_of_somebody_else_is_no_place_for_a_video(tmp_path):
    path = tmp_path / "hand.mp4"
    refuse_foreign_video("--video", path)
    write_video(path, [np.zeros((16, 16, 3), np.uint8)] * 2, 30.0)
    refuse_foreign_video("--video", path)
    path.write_bytes(path.read_bytes().replace(b"Made by JGHand", b"a holiday film"))
    with pytest.raises(InputError, match="another file"):
        refuse_foreign_video("--video", path)
