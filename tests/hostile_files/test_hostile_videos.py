"""Video files that are none, are damaged, or want something: refused with a sentence, and soon."""

import subprocess
import time

import numpy as np
import pytest

from jghand_engine.errors import InputError
from jghand_engine.export.video import ffmpeg_program, write_video
from jghand_engine.track import video
from jghand_engine.track.video import open_video, read_frames

pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")


@pytest.fixture(scope="module")
def film(tmp_path_factory):
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    random = np.random.default_rng(0)
    write_video(path, (random.integers(0, 255, (48, 64, 3), dtype=np.uint8) for _ in range(6)), 30)
    return path


def refused(path, match):
    with pytest.raises(InputError, match=match) as told:
        list(read_frames(open_video(path)))
    assert len(str(told.value)) < 600
    assert "\n" not in str(told.value)


def test_what_is_not_there(tmp_path):
    refused(tmp_path / "none.mp4", "cannot read video")


def test_a_folder(tmp_path):
    refused(tmp_path, "a folder")


def test_an_empty_file(tmp_path):
    (tmp_path / "empty.mp4").touch()
    refused(tmp_path / "empty.mp4", "no bytes")


@pytest.mark.parametrize(
    "content",
    [b"\x00" * 4096, b"no film at all\n" * 100, b"\x89PNG\r\n\x1a\n" + b"\x00" * 64],
    ids=["zeros", "text", "picture"],
)
def test_something_else(tmp_path, content):
    (tmp_path / "odd.mp4").write_bytes(content)
    refused(tmp_path / "odd.mp4", "a film that ffmpeg can read")


def test_a_film_whose_index_is_missing(film, tmp_path):
    (tmp_path / "short.mp4").write_bytes(film.read_bytes()[:200])
    refused(tmp_path / "short.mp4", "a film that ffmpeg can read")


@pytest.mark.parametrize(
    "text",
    [
        "#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{film}\n#EXT-X-ENDLIST\n",
        "ffconcat version 1.0\nfile '{film}'\n",
    ],
)
def test_a_list_that_names_other_files_is_not_followed(film, tmp_path, text):
    (tmp_path / "list.mp4").write_text(text.format(film=film))
    refused(tmp_path / "list.mp4", "a film that ffmpeg can read")


def test_absurd_sizes_are_refused_before_a_picture_is_decoded(film, monkeypatch):
    monkeypatch.setattr(video, "VIDEO_EDGE_MAX_PX", 60)
    refused(film, "64 x 48")


def test_too_many_pictures(film, monkeypatch):
    monkeypatch.setattr(video, "TRACK_FRAMES_MAX", 5)
    refused(film, "at most 5 pictures")
    assert len(list(read_frames(open_video(film, most=4), most=4))) == 4, "its beginning can be had"


def test_too_many_pictures_of_a_film_that_does_not_say_how_many(film, tmp_path, monkeypatch):
    raw = tmp_path / "raw.h264"
    command = [ffmpeg_program(), "-loglevel", "error", "-i", str(film), "-c", "copy", str(raw)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    monkeypatch.setattr(video, "TRACK_FRAMES_MAX", 4)
    notes = []
    assert len(list(read_frames(open_video(raw), notes))) == 4
    assert "more than 4 pictures: its first 4 were read" in notes[0]
    notes = []
    assert len(list(read_frames(open_video(raw, most=3), notes, most=3))) == 3
    assert notes == []


@pytest.mark.parametrize(("width", "height"), [(512, 16), (16, 512)])
def test_strips_in_which_a_search_would_take_minutes(tmp_path, width, height):
    write_video(tmp_path / "thin.mp4", (np.zeros((height, width, 3), np.uint8) for _ in range(3)), 30)
    refused(tmp_path / "thin.mp4", "5 times as long as wide")


def test_pixels_of_an_absurd_shape(film, tmp_path):
    path = tmp_path / "shape.mp4"
    command = [ffmpeg_program(), "-loglevel", "error", "-i", str(film), "-vf", "setsar=1/20", "-c:v", "libx264"]
    subprocess.run([*command, str(path)], check=True, stdin=subprocess.DEVNULL)
    refused(path, "5 times as long as wide")


@pytest.mark.parametrize("seed", range(6))
def test_flipped_bytes_give_pictures_or_a_sentence(film, tmp_path, seed):
    random = np.random.default_rng(seed)
    content = bytearray(film.read_bytes())
    for place in random.integers(0, len(content), 1 + 4 * seed):
        content[place] = random.integers(0, 256)
    path = tmp_path / "flipped.mp4"
    path.write_bytes(content)
    started = time.monotonic()
    read, sentence = [], ""
    try:
        read += read_frames(open_video(path))
    except InputError as error:
        sentence = str(error)
    assert read or sentence
    assert "\n" not in sentence
    assert all(picture.shape == read[0].shape for picture in read)
    assert time.monotonic() - started < 30, "it ends; seen: 0.3 s"
