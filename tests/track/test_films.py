"""Pictures out of video files."""

import subprocess

import numpy as np
import pytest
from PIL import Image

from jghand_engine.errors import InputError
from jghand_engine.export.video import ffmpeg_program, write_video
from jghand_engine.track import video as video_module
from jghand_engine.track.video import open_video, read_frames

pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")


def moving_square(count, height=48, width=64):
    for index in range(count):
        picture = np.full((height, width, 3), (180, 140, 120), np.uint8)
        picture[8:24, 2 * index : 2 * index + 16] = (40, 60, 200)
        yield picture


def film(path, count=20, fps=30.0, **size):
    write_video(path, moving_square(count, **size), fps)
    return path


def converted(source, target, *options, before=()):
    command = [ffmpeg_program(), "-y", "-loglevel", "error", *before, "-i", str(source), *options, str(target)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return target


def test_every_picture_comes_in_its_order(tmp_path):
    video = open_video(film(tmp_path / "a.mp4"))
    assert (video.width, video.height, video.fps, video.frames, video.turned_deg) == (64, 48, 30.0, 20, 0)
    assert not video.uneven
    read = list(read_frames(video))
    assert len(read) == 20
    errors = [np.abs(a.astype(int) - b).mean() for a, b in zip(read, moving_square(20), strict=True)]
    assert max(errors) < 4, "worst seen 2.2 of 255: the compression"


def test_no_more_pictures_than_wanted(tmp_path):
    video = open_video(film(tmp_path / "a.mp4"))
    notes = []
    assert len(list(read_frames(video, notes, most=7))) == 7
    assert notes == []


def test_a_name_that_looks_like_an_option_or_an_address_is_a_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("-y.mp4", "http:film.mp4", "ümlaut und leer.mp4"):
        film(tmp_path / "plain.mp4", 3).rename(tmp_path / name)
        assert len(list(read_frames(open_video(name)))) == 3


def test_a_turned_film_is_read_upright(tmp_path):
    plain = film(tmp_path / "a.mp4")
    turned = converted(plain, tmp_path / "turned.mp4", "-c", "copy", before=("-display_rotation", "90"))
    video = open_video(turned)
    assert (video.width, video.height) == (48, 64)
    assert video.turned_deg % 180 == 90
    assert next(iter(read_frames(video))).shape == (64, 48, 3)


def square_at(picture):
    """Which picture of `moving_square` that is, by where its square is."""
    dark = np.clip(150 - picture[10:22, :, 0].astype(float), 0, None).sum(0)
    return (float((dark * np.arange(len(dark))).sum() / dark.sum()) - 7.5) / 2


@pytest.mark.parametrize("fps", [None, 30.0])
def test_uneven_times_are_made_even(tmp_path, fps):
    """Every picture of the first half is followed at once, in the second half two of three are left out."""
    plain = film(tmp_path / "a.mp4", 60, width=160)
    uneven = converted(
        plain, tmp_path / "u.mp4", "-vf", "select='lt(n,30)+not(mod(n,3))'", "-fps_mode", "vfr", "-c:v", "libx264"
    )
    assert open_video(uneven).uneven
    video = open_video(uneven, fps=fps)
    read = list(read_frames(video))
    assert abs(len(read) / video.fps - 2.0) < 0.1, "as long as the film, not as many as its 40 pictures; seen: 0.067"
    # what is shown at a moment is what was filmed there, but for what was left out
    late = np.arange(len(read)) * 30 / video.fps - [square_at(picture) for picture in read]
    assert late.min() > -0.7, "in pictures; seen -0.65: a moment of another rate takes the nearest picture"
    assert late.max() < 2.3, "seen 2.25"


def test_times_that_keep_no_rate_are_told(tmp_path):
    random = converted(
        film(tmp_path / "a.mp4", 60, width=160), tmp_path / "r.mp4", "-vf", "settb=1/90000,setpts='PTS+2500*random(0)'",
        *("-fps_mode", "passthrough", "-enc_time_base", "1/90000", "-video_track_timescale", "90000"),
        *("-c:v", "libx264", "-bf", "0"),
    )  # fmt: skip
    assert open_video(random).uneven


def test_pixels_that_are_not_square_are_made_square(tmp_path):
    wide = converted(film(tmp_path / "a.mp4"), tmp_path / "wide.mp4", "-vf", "setsar=64/45", "-c:v", "libx264")
    video = open_video(wide)
    assert (video.width, video.height) == (92, 48), "64 x 64 / 45, even"
    read = list(read_frames(video))
    assert read[0].shape == (48, 92, 3)
    turned = converted(wide, tmp_path / "turned.mp4", "-c", "copy", before=("-display_rotation", "90"))
    assert next(iter(read_frames(open_video(turned)))).shape == (92, 48, 3)
    high = converted(film(tmp_path / "a.mp4"), tmp_path / "high.mkv", "-vf", "setsar=1/2", "-c:v", "libx264")
    assert next(iter(read_frames(open_video(high)))).shape == (48, 32, 3)


def test_another_rate_takes_fewer_pictures(tmp_path):
    video = open_video(film(tmp_path / "a.mp4"), fps=15.0)
    assert len(list(read_frames(video))) == 10


def test_large_pictures_are_made_smaller(tmp_path, monkeypatch):
    monkeypatch.setattr(video_module, "TRACK_EDGE_PX", 32)
    video = open_video(film(tmp_path / "a.mp4"))
    assert (video.width, video.height) == (32, 24)
    assert next(iter(read_frames(video))).shape == (24, 32, 3)


def test_rates_of_television_are_exact(tmp_path):
    assert open_video(film(tmp_path / "a.mp4", 20, 30000 / 1001)).fps == 30000 / 1001


def test_a_film_that_is_cut_off_gives_what_is_there_and_says_so(tmp_path):
    whole = converted(film(tmp_path / "a.mp4", 90), tmp_path / "a.mkv", "-c:v", "libx264", "-g", "5")
    part = tmp_path / "part.mkv"
    part.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    notes = []
    count = len(list(read_frames(open_video(part), notes)))
    assert 0 < count < 90
    assert "cut off" in notes[0]
    assert str(count) in notes[0]


def test_a_film_that_is_cut_off_without_a_word_of_the_decoder_says_so_too(tmp_path):
    whole = converted(film(tmp_path / "a.mp4", 120), tmp_path / "a.flv", "-c:v", "libx264", "-g", "5")
    part = tmp_path / "part.flv"
    part.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    notes = []
    count = len(list(read_frames(open_video(part), notes)))
    assert f"cut off: {count} of about 12" in notes[0]


def test_a_film_with_longer_sound_and_a_cover_is_a_whole_film(tmp_path):
    Image.new("RGB", (64, 64), (255, 0, 0)).save(tmp_path / "cover.png")
    sound = ("-i", str(tmp_path / "cover.png"), "-f", "lavfi", "-i", "sine=duration=6")
    streams = ("-map", "1:v", "-map", "0:v", "-map", "2:a", "-c:v:0", "png", "-c:v:1", "copy")
    target = tmp_path / "s.mp4"
    converted(film(tmp_path / "a.mp4"), target, *sound, *streams, "-disposition:v:0", "attached_pic")
    notes = []
    read = list(read_frames(open_video(target), notes))
    assert len(read) == 20
    assert read[0].shape == (48, 64, 3)
    assert notes == [], "nothing of it is damaged"


def test_a_film_whose_first_picture_comes_late_is_a_whole_film(tmp_path):
    late = converted(film(tmp_path / "a.mp4", 90), tmp_path / "late.mkv", "-c", "copy", before=("-itsoffset", "5"))
    video, notes = open_video(late), []
    assert len(list(read_frames(video, notes))) == 90
    assert video.frames == 90
    assert notes == []


def test_a_film_with_longer_subtitles_is_a_whole_film(tmp_path):
    (tmp_path / "words.srt").write_text("1\n00:00:00,000 --> 00:00:09,000\nwords\n")
    target = tmp_path / "s.mkv"
    converted(film(tmp_path / "a.mp4"), target, "-i", str(tmp_path / "words.srt"), "-c:v", "copy")
    notes = []
    assert len(list(read_frames(open_video(target), notes))) == 20
    assert notes == []


@pytest.mark.parametrize(("most", "told"), [(None, True), (18, True), (11, True), (10, False), (3, False)])
def test_a_film_that_turns_out_to_be_too_long_is_read_from_its_beginning_and_that_is_told(
    tmp_path, monkeypatch, most, told
):
    video = open_video(film(tmp_path / "a.mp4"), most=most)
    monkeypatch.setattr(video_module, "TRACK_FRAMES_MAX", 10)
    notes = []
    assert len(list(read_frames(video, notes, most=most))) == min(most or 10, 10)
    assert notes == ([f"{video.path} has more than 10 pictures: its first 10 were read."] if told else [])


def test_leaving_early_ends_the_decoder(tmp_path):
    reading = read_frames(open_video(film(tmp_path / "a.mp4", 60)))
    next(reading)
    reading.close()


def test_a_film_without_a_picture_is_an_error(tmp_path):
    video = open_video(film(tmp_path / "a.mp4"))
    video.path.write_bytes(b"gone")
    with pytest.raises(InputError, match="at least one picture"):
        list(read_frames(video))
