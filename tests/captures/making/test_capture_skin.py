"""The skin of a capture, baked into the template's UV."""

from __future__ import annotations

import numpy as np
import pytest
from PIL import Image

from jghand_engine.captures.making import skin as skin_module
from jghand_engine.captures.making.skin import TEXTURE_PX, make_skin, read_texture
from jghand_engine.errors import InputError
from jghand_engine.template.builtin import load_template
from jghand_engine.template.texture import rasterize_uv


@pytest.fixture(autouse=True)
def _small(monkeypatch):
    """A quarter of the edge: the same work in a sixteenth of the time."""
    monkeypatch.setattr(skin_module, "SKIN_PX", 256)


@pytest.fixture(scope="module")
def striped(tmp_path_factory):
    """A picture that is red where u is below a half, else green."""
    rgb = np.zeros((128, 128, 3), np.uint8)
    rgb[:, :64, 0] = rgb[:, 64:, 1] = 200
    path = tmp_path_factory.mktemp("skin") / "striped.png"
    Image.fromarray(rgb).save(path)
    return path


def covered_px(size: int) -> np.ndarray:
    template = load_template()
    uv = template.face_uv[: template.skin_face_count]
    return rasterize_uv(uv, uv, size)[1]


def test_a_picture_lands_where_its_uv_says(striped):
    skin = make_skin(striped)
    left, right = skin.rgb8[:, :120], skin.rgb8[:, 136:]
    covered = covered_px(256)
    nails = skin.nail > 0.05
    assert (left[covered[:, :120] & ~nails[:, :120]][:, 0] > 150).all()
    assert (right[covered[:, 136:] & ~nails[:, 136:]][:, 1] > 150).all()


def test_around_the_island_the_nearest_skin_goes_on(tmp_path):
    """Else filters would pull foreign color over the seams."""
    Image.fromarray(np.where(covered_px(256)[..., None], [180, 140, 120], [0, 0, 255]).astype(np.uint8)).save(
        tmp_path / "island.png"
    )
    skin = make_skin(tmp_path / "island.png")
    # mottling alone differs; blue would be 255
    assert skin.rgb8[..., 2].max() < 140
    assert skin.rgb8[..., 0].min() > 150


def test_the_wrists_cut_has_one_color_and_no_relief(striped):
    template = load_template()
    skin = make_skin(striped)
    uv = template.face_uv[template.skin_face_count :].reshape(-1, 2).mean(0)
    row, column = int((1 - uv[1]) * 256), int(uv[0] * 256)
    patch = skin.rgb8[row - 8 : row + 8, column - 8 : column + 8].reshape(-1, 3)
    assert (patch == patch[0]).all()
    assert (skin.relief_m[row - 8 : row + 8, column - 8 : column + 8] == 0).all()


def test_the_relief_stays_small_and_nails_are_smooth(striped):
    skin = make_skin(striped)
    assert np.abs(skin.relief_m).max() < 1.5e-3
    # what is left is the nail's own soft edge: observed 9e-8 m
    assert np.abs(skin.relief_m[skin.nail > 0.99]).max() < 2e-7
    assert 0.001 < (skin.nail > 0.5).mean() < 0.03


def test_the_same_seed_bakes_the_same_skin(striped):
    np.testing.assert_array_equal(make_skin(striped, 3).rgb8, make_skin(striped, 3).rgb8)
    assert not np.array_equal(make_skin(striped, 3).rgb8, make_skin(striped, 4).rgb8)


def test_what_is_no_skin_picture_is_refused(tmp_path):
    (tmp_path / "no.png").write_bytes(b"\x89PNG\r\n\x1a\n broken")
    Image.new("RGB", (100, 120)).save(tmp_path / "oblong.png")
    Image.new("RGB", (TEXTURE_PX[0] - 1,) * 2).save(tmp_path / "tiny.png")
    for name in ("no.png", "oblong.png", "tiny.png", "absent.png"):
        with pytest.raises(InputError, match=name):
            read_texture(tmp_path / name)
