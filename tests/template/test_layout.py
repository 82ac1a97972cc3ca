"""UV layouts: made by projection, read from a file that may be wrong, and where the wrist's cap has room in them."""

import numpy as np
import pytest
import trimesh

from jghand_engine.errors import InputError
from jghand_engine.template import layout
from jghand_engine.template.layout import CAP_UV_RADIUS_MAX, UV_MARGIN, obj_uv, projected_uv, room_for_disk
from jghand_engine.template.surface import face_normals

FACES = np.array([[0, 1, 2]])
COORDINATES = "vt 0 0\nvt 1 0\nvt 0.25 1\nvt 1 0.5\n"


@pytest.mark.parametrize("size_m", [(0.1, 0.4, 0.03), (0.4, 0.1, 0.03)], ids=["high", "wide"])
def test_a_projection_shows_palm_and_back_side_by_side_and_fills_the_square(size_m):
    box = trimesh.creation.box(size_m)
    vertices, faces = np.asarray(box.vertices) + np.array([0.3, -0.2, 0.1]), np.asarray(box.faces)
    uv, towards = projected_uv(vertices, faces), face_normals(vertices, faces)[:, 2]
    width, height = size_m[:2]
    scale = min((1 - 3 * UV_MARGIN) / (2 * width), (1 - 2 * UV_MARGIN) / height)
    for side, first_m, begin in ((1, 0.3 - width / 2, UV_MARGIN), (-1, 0.3 + width / 2, 2 * UV_MARGIN + scale * width)):
        away_m = np.abs(vertices[faces[towards == side]][..., :2] - np.array([first_m, -0.2 - height / 2]))
        np.testing.assert_allclose(uv[towards == side], scale * away_m + np.array([begin, UV_MARGIN]), atol=1e-12)


@pytest.mark.parametrize(
    "face", ["1/1 2/2 3/3 3/3", "1/1 2/2 2/3", "1/1 2/2 3/5", "1/1 2/2 3/9", "0/1 2/2 3/3", "1/0 2/2 3/3", "1 2 3"]
)
def test_a_face_that_is_no_triangle_with_coordinates_is_refused_with_its_line(tmp_path, face):
    (tmp_path / "uv.obj").write_text(f"{COORDINATES}f {face}\n")
    with pytest.raises(InputError, match="line 5"):
        obj_uv(tmp_path / "uv.obj", FACES)


def test_a_layout_that_is_none_is_refused(tmp_path, monkeypatch):
    whole = f"{COORDINATES}f 1/1 2/2 3/3\n"
    (tmp_path / "whole.obj").write_text(whole)
    monkeypatch.setattr(layout, "OBJ_BYTES_MAX", (tmp_path / "whole.obj").stat().st_size)
    assert len(obj_uv(tmp_path / "whole.obj", FACES)) == 1
    others = {"": "coordinates 0", "vt 0 1.1": "coordinates 0", "vt -0.1 0": "coordinates 0", "vt 0": "line 1"}
    for text, message in {**others, COORDINATES: r"vertices \[0, 1, 2\]", whole + " ": "at most"}.items():
        (tmp_path / "other.obj").write_text(text)
        with pytest.raises(InputError, match=message):
            obj_uv(tmp_path / "other.obj", FACES)


def test_room_for_the_cap_touches_nothing():
    uv = np.array([[[0, 0], [0.8, 0], [0, 0.8]], [[0.8, 0], [0.8, 0.4], [0.3, 0.5]]])
    (u, v), radius = room_for_disk(uv)
    assert radius > 0
    edge = [(u + radius * np.cos(a), v + radius * np.sin(a)) for a in np.linspace(0, 6.3, 30)]
    assert all(0 <= x <= 1 and 0 <= y <= 1 and x + y > 0.8 for x, y in edge)


def test_the_cap_is_as_large_as_its_room_and_no_larger_than_needed():
    for left, least in ((0.98, 0.003), (0.9, 0.034), (0.7, CAP_UV_RADIUS_MAX)):
        (u, _), radius = room_for_disk(np.array([[[0, 0], [left, 0], [0, 1]], [[left, 0], [left, 1], [0, 1]]]))
        assert least <= radius <= CAP_UV_RADIUS_MAX
        assert left < u - radius < u + radius < 1


def test_a_full_layout_has_no_room():
    full = np.array([[[0, 0], [1, 0], [0, 1]], [[1, 0], [1, 1], [0, 1]]], dtype=float)
    with pytest.raises(InputError, match="room"):
        room_for_disk(full)
