"""Pictures of a world from files: three formats, averaging over solid angle, and files that are none."""

from pathlib import Path

import numpy as np
import pytest

from jghand_engine.avatar.scene_light import World
from jghand_engine.avatar.world_suns import averaged
from jghand_engine.errors import InputError
from jghand_engine.export.light_file import COLUMNS_MAX, ROWS_MAX, read_world_picture

PICTURE = np.random.default_rng(0).lognormal(0, 2, (9, 20, 3)).astype(np.float32)


def rgbe(picture: np.ndarray) -> np.ndarray:
    """(H, W, 4) as Radiance has it."""
    exponent = np.ceil(np.log2(picture.max(-1, keepdims=True)) + 1e-3)
    return np.concatenate([picture * 256 / 2**exponent, exponent + 128], -1).astype(np.uint8)


def hdr(path: Path, pixels: np.ndarray, *, packed: bool) -> Path:
    """Writes rows of RGBE, packed into single values and, where a channel has one value alone, into runs."""
    body = b""
    for row in pixels:
        if packed:
            body += bytes([2, 2, len(row) >> 8, len(row) & 255])
            for channel in row.T:
                even = (channel == channel[0]).all()
                body += bytes([128 + len(row), channel[0]]) if even else bytes([len(row), *channel])
        else:
            body += row.tobytes()
    size = f"-Y {pixels.shape[0]} +X {pixels.shape[1]}\n".encode()
    path.write_bytes(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n" + size + body)
    return path


def power(picture: np.ndarray) -> np.ndarray:
    return World(picture).samples[1].sum((0, 1))


@pytest.mark.parametrize("packed", [False, True])
def test_radiance_files_are_read(tmp_path, packed):
    pixels = rgbe(PICTURE)
    pixels[4] = (128, 64, 32, 130)  # 2, 1, 0.5
    read = read_world_picture(hdr(tmp_path / "world.hdr", pixels, packed=packed))
    np.testing.assert_array_equal(read[4], np.tile(np.float32([2, 1, 0.5]), (20, 1)))
    # each channel within a step of the largest
    largest = PICTURE.max(-1, keepdims=True)
    rows = [row for row in range(9) if row != 4]
    assert (np.abs(read - PICTURE)[rows] <= largest[rows] / 127).all()


def test_numpy_files_are_read_and_what_no_light_has_is_none(tmp_path):
    picture = PICTURE.copy()
    picture[0, :4, 0] = -1, np.nan, np.inf, -np.inf
    np.save(tmp_path / "world.npy", picture)
    picture[0, :4, 0] = 0
    np.testing.assert_array_equal(read_world_picture(tmp_path / "world.npy"), picture)


def test_exr_files_are_read(tmp_path):
    package = pytest.importorskip("OpenEXR")
    header = {"type": package.scanlineimage, "compression": package.ZIP_COMPRESSION}
    for name, channels in (("RGB", 3), ("RGBA", 4)):
        picture = np.dstack([PICTURE, np.ones((9, 20, 1), np.float32)])[..., :channels].copy()
        package.File(header, {name: picture}).write(str(tmp_path / "world.exr"))
        np.testing.assert_array_equal(read_world_picture(tmp_path / "world.exr"), PICTURE)


@pytest.mark.parametrize("shape", [(600, 1300), (256, 512), (257, 1024), (20, 3000)])
def test_averaging_keeps_light_and_where_it_comes_from(shape):
    picture = np.random.default_rng(1).lognormal(0, 2, (*shape, 3)).astype(np.float32)
    small = averaged(picture, ROWS_MAX, COLUMNS_MAX)
    assert small.shape == (min(shape[0], 256), min(shape[1], 512), 3)
    np.testing.assert_allclose(power(small), power(picture), rtol=1e-5)
    spot = np.zeros((*shape, 3), np.float32)
    spot[shape[0] // 5, shape[1] // 3] = 1
    means = []
    for each in (spot, averaged(spot, ROWS_MAX, COLUMNS_MAX)):
        direction, light = World(each).samples
        mean = (direction * light).sum((0, 1))
        means.append(mean / np.linalg.norm(mean))
    assert means[0] @ means[1] > np.cos(np.pi / 256)


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("world.png", b"", "wanted a picture in .hdr, .exr or .npy"),
        ("world.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 90000 +X 90000\nshort", "too short"),
        ("world.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 2 +X 20\n\x02\x02\x00\x14\xff\x00", "damaged"),
        ("world.hdr", b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n+X 4 -Y 4\n", "from the top"),
        ("world.hdr", b"P6 4 4", "RGBE"),
        ("world.npy", b"nothing", "cannot read"),
        ("world.exr", b"nothing", "cannot read"),
    ],
)
def test_what_is_no_picture_says_so(tmp_path, name, content, said):
    if name.endswith(".exr"):
        pytest.importorskip("OpenEXR")
    (tmp_path / name).write_bytes(content)
    with pytest.raises(InputError, match=said):
        read_world_picture(tmp_path / name)


def test_a_file_that_is_not_there_and_a_gray_one_say_so(tmp_path):
    with pytest.raises(InputError, match="cannot read"):
        read_world_picture(tmp_path / "gone.hdr")
    np.save(tmp_path / "gray.npy", PICTURE[..., 0])
    with pytest.raises(InputError, match="three channels"):
        read_world_picture(tmp_path / "gray.npy")
