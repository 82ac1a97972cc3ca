"""The pictures that an avatar is made of: films and photographs, which of them, and what their files say."""

import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from tracking_samples import moving_poses, right_joints_m, sight

from jghand_engine.errors import InputError
from jghand_engine.export.video import ffmpeg_program, write_video
from jghand_engine.hand.joints import Handedness
from jghand_engine.own.film import (
    HAND_SIZE_PX,
    PICTURE_EDGE_PX,
    FilmPictures,
    Window,
    blurred,
    look,
    open_source,
    read_pictures,
    spread_pictures,
    view_angle_deg,
)
from jghand_engine.track.poses import Poses

NOISE = np.random.default_rng(0).integers(0, 256, (480, 640, 3)).astype(np.uint8)


def photograph(path: Path, size: tuple[int, int] = (64, 48), focal_35mm: object = None) -> Path:
    exif = Image.Exif()
    if focal_35mm is not None:
        exif.get_ifd(0x8769)[41989] = focal_35mm
    Image.fromarray(NOISE[: size[1], : size[0]]).save(path, exif=exif)
    return path


def photographs(folder: Path, count: int, focal_35mm: object = None) -> list[Path]:
    return [photograph(folder / f"{number}.jpg", focal_35mm=focal_35mm) for number in range(count)]


def film(path: Path, fps: float = 30.0, count: int = 8) -> Path:
    shown = [np.full((48, 64, 3), 20 + 20 * number, np.uint8) for number in range(count)]
    write_video(path, shown, fps)
    return path


def test_three_photographs_suffice_and_two_or_eleven_are_refused(tmp_path):
    paths = photographs(tmp_path, 11)
    source = open_source(paths[:3])
    assert (source.is_film, source.count, source.size_px, len(list(source.read()))) == (False, 3, (48, 64), 3)
    for some in (paths[:1], paths[:2], paths):
        with pytest.raises(InputError, match="3 to 10 photographs"):
            open_source(some)


def test_a_film_among_photographs_and_photographs_of_two_sizes_are_refused(tmp_path):
    paths = photographs(tmp_path, 3)
    with pytest.raises(InputError, match="and other files"):
        open_source([*paths, tmp_path / "hand.mp4"])
    with pytest.raises(InputError, match="all of one size"):
        open_source([*paths, photograph(tmp_path / "across.png", (48, 64))])


def test_the_angle_of_view_is_what_the_photograph_says(tmp_path):
    assert open_source(photographs(tmp_path, 3, focal_35mm=26)).camera_angle_deg == pytest.approx(67.3, abs=0.1)
    assert open_source(photographs(tmp_path, 3)).camera_angle_deg is None


@pytest.mark.parametrize("focal_35mm", [(26, 52), 1, 0])
def test_a_lens_that_cannot_be_says_no_angle_of_view(tmp_path, focal_35mm):
    assert open_source(photographs(tmp_path, 3, focal_35mm=focal_35mm)).camera_angle_deg is None


def test_photographs_that_cannot_be_read_are_named_with_what_to_do(tmp_path):
    with pytest.raises(InputError, match=r"got 0 photographs and other files \(\.heic\)\. Save photographs as JPEG"):
        open_source([tmp_path / f"{number}.heic" for number in range(4)])


def test_the_angle_of_view_is_what_the_film_of_a_telephone_says(tmp_path):
    plain, told = film(tmp_path / "plain.mp4"), tmp_path / "told.mov"
    words = [
        "-movflags",
        "use_metadata_tags",
        "-metadata",
        "com.apple.quicktime.camera.focal_length.35mm_equivalent=24",
    ]
    subprocess.run([ffmpeg_program(), "-v", "error", "-i", plain, "-c", "copy", *words, told], check=True)
    assert open_source([plain]).camera_angle_deg is None
    assert open_source([told]).camera_angle_deg == pytest.approx(view_angle_deg(24, 64, 48))


def test_of_a_fast_film_every_second_picture_is_looked_at_and_stays_what_it_was(tmp_path):
    source = open_source([film(tmp_path / "hand.mp4", fps=30.0, count=8)])
    shown = [int(picture.mean().round()) for picture in source.read()]
    assert source.fps == pytest.approx(15)
    assert len(shown) == 4
    assert all(abs(value - 20) % 20 in (0, 1, 2, 18, 19) for value in shown)


def test_pictures_that_differ_are_chosen_and_those_that_repeat_are_not():
    poses = moving_poses(40)
    still = Poses(*(np.concatenate([part[:1].repeat(100, 0), part[20:23]]) for part in vars(poses).values()))
    chosen = spread_pictures(still, np.ones(103, bool), 4)
    assert set(chosen) >= {100, 101, 102}
    unseen = np.ones(103, bool)
    unseen[101] = False
    assert 101 not in spread_pictures(still, unseen, 4)
    assert spread_pictures(still, np.arange(103) < 3, 4).tolist() == [0, 1, 2]
    alike = spread_pictures(still, np.arange(103) < 100, 4)
    assert len(set(alike.tolist())) == 4


class Perfect:
    def __init__(self) -> None:
        self.frames = sight(right_joints_m(2)).sightings.frames

    def detect(self, rgb8: np.ndarray, time_s: float) -> list:
        return self.frames[0] if time_s < 5 else []


def test_a_picture_that_is_blurred_about_the_hand_is_told(tmp_path):
    soft = np.asarray(Image.fromarray(NOISE).resize((20, 15)).resize((640, 480), Image.Resampling.BICUBIC))
    paths = [tmp_path / f"{number}.png" for number in range(6)]
    for number, path in enumerate(paths):
        Image.fromarray(soft if number == 1 else NOISE).save(path)
    told = []
    looked = look(open_source(paths), Perfect(), told.append)
    assert blurred(looked.sharpness).tolist() == [False, True, False, False, False, False]
    assert np.isnan(looked.sharpness[-1])
    assert told == [1, 2, 3, 4, 5, 6]


def test_pictures_are_read_by_number_kept_as_they_are_and_mirrored_for_a_left_hand(tmp_path):
    paths = photographs(tmp_path, 4)
    whole = Window(0, 0, 64, 48, (64, 48))
    source = open_source(paths)
    pictures, mirrored = (read_pictures(source.showing_right(hand), np.array([1, 3]), whole) for hand in Handedness)
    assert (len(pictures), pictures.index.tolist(), pictures.time_s.tolist()) == (2, [1, 3], [1.0, 3.0])
    assert np.array_equal(pictures.rgb_u8[:, :, ::-1], mirrored.rgb_u8)
    assert pictures.digest != mirrored.digest
    pictures.save(tmp_path / "pictures.npz")
    again = FilmPictures.load(tmp_path / "pictures.npz")
    assert np.array_equal(again.rgb_u8, pictures.rgb_u8)
    assert (again.source, again.digest, again.is_film) == ("0.jpg", pictures.digest, False)


def test_what_is_kept_is_the_part_where_the_hand_is_and_no_larger_than_it_need_be():
    points = np.array([[300.0, 400.0], [700.0, 500.0]])
    near = Window.around(points, 200.0, (1080, 1920))
    assert (near.left, near.top, near.width, near.height) == (200, 300, 600, 300)
    assert near.size_px == (600, 300)
    large = Window.around(points, 800.0, (1080, 1920))
    assert (large.left, large.top, large.width, large.height) == (0, 0, 1080, 900)
    assert large.size_px == (round(1080 * HAND_SIZE_PX / 800), round(900 * HAND_SIZE_PX / 800))
    assert max(Window.around(points * 3, 100.0, (4000, 4000)).size_px) == PICTURE_EDGE_PX
    picture = np.zeros((1920, 1080, 3), np.uint8)
    picture[300:600, 200:800] = 200
    assert (near.cut(picture) == 200).all()
