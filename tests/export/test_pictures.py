"""PNG with straight alpha, flattening, contact sheets."""

import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jghand_engine.color import to_bytes
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import Cell, SheetStyle, contact_sheet, flatten, read_png, straight_rgba8, write_png


def test_bytes_are_rounded_to_the_nearest_step_and_clipped():
    steps = np.arange(256) / 255
    assert (to_bytes(steps) == np.arange(256)).all()
    assert to_bytes(np.array([-1.0, 0.49 / 255, 0.51 / 255, 2.0])).tolist() == [0, 0, 1, 255]


def test_png_holds_straight_color_and_survives_the_way_through_the_file(tmp_path):
    color, alpha = np.array([0.8, 0.4, 0.2], np.float32), np.float32(0.5)
    picture = np.zeros((3, 5, 4), np.float32)
    picture[1, 2] = (*color * alpha, alpha)
    write_png(tmp_path / "frame.png", picture)
    back = read_png(tmp_path / "frame.png")
    assert back.shape == (3, 5, 4)
    assert back[1, 2].tolist() == [204, 102, 51, 128]
    assert np.argwhere(back.any(-1)).tolist() == [[1, 2]]


@given(st.floats(0, 1, width=32), st.floats(0, 1, width=32))
def test_flattening_agrees_with_the_formula(alpha, background):
    rgba = np.array([[[0.3 * alpha, 0.2 * alpha, 0.1 * alpha, alpha]]])
    expected = np.array([0.3, 0.2, 0.1]) * alpha + (1 - alpha) * background
    got = flatten(rgba, (background,) * 3)[0, 0] / 255
    assert np.abs(got - expected).max() <= 0.5 / 255 + 1e-9  # half a step: the rounding


def test_color_brighter_than_its_alpha_is_clipped_not_wrapped():
    assert straight_rgba8(np.array([[[1.0, 0.5, 0.0, 0.1]]]))[0, 0].tolist() == [255, 255, 0, 26]


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_a_picture_with_values_that_are_not_finite_is_refused(tmp_path, value):
    picture = np.zeros((2, 2, 4), np.float32)
    picture[0, 1, 2] = value
    with pytest.raises(InputError, match="1 pixels"):
        write_png(tmp_path / "frame.png", picture)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("shape", [(4, 4), (4, 4, 3), (4, 4, 5)])
def test_a_float_picture_of_another_shape_is_refused(tmp_path, shape):
    with pytest.raises(InputError, match="shape"):
        write_png(tmp_path / "frame.png", np.zeros(shape, np.float32))


def test_a_picture_that_claims_more_pixels_than_any_is_bad_input(tmp_path, monkeypatch):
    write_png(tmp_path / "bomb.png", np.zeros((10, 10, 3), np.uint8))
    monkeypatch.setattr("PIL.Image.MAX_IMAGE_PIXELS", 40)
    with pytest.raises(InputError, match=r"bomb\.png.*decompression bomb"):
        read_png(tmp_path / "bomb.png")


def test_a_picture_cut_or_damaged_anywhere_is_bad_input_or_a_picture(tmp_path):
    rng = np.random.default_rng(0)
    write_png(tmp_path / "x.png", rng.integers(0, 255, (8, 8, 4), dtype=np.uint8))
    whole = (tmp_path / "x.png").read_bytes()
    damaged = [whole[:length] for length in range(0, len(whole), 7)]
    for _ in range(300):
        changed = bytearray(whole)
        changed[rng.integers(len(whole))] = rng.integers(256)
        damaged.append(bytes(changed))
    for content in damaged:
        (tmp_path / "x.png").write_bytes(content)
        with contextlib.suppress(InputError):
            assert read_png(tmp_path / "x.png").ndim == 3


def test_contact_sheet_shows_every_picture_in_its_place():
    style = SheetStyle(columns=2, cell_px=40, gap_px=5)
    colors = [(250, 0, 0), (0, 250, 0), (0, 0, 250)]
    cells = [Cell(str(i), np.full((20, 40, 3), color, np.uint8)) for i, color in enumerate(colors)]
    sheet = contact_sheet(cells, style)
    assert sheet.shape[1] == 2 * 45 + 5
    found = [np.argwhere((sheet == color).all(-1)) for color in colors]
    assert [len(points) for points in found] == [800, 800, 800]
    (top0, left0), (top1, left1), (top2, left2) = (points.min(0) for points in found)
    assert (top0, left0, top1, left1, left2) == (5, 5, 5, 50, 5)
    assert top2 > top0 + 20
    ink = (sheet < 120).all(-1)
    assert ink[25:top2].any(), "the labels are there"
