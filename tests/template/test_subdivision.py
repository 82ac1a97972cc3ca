"""Loop's subdivision as one sparse matrix."""

import numpy as np
import pytest

from jghand_engine.hand.rotations import unit
from jghand_engine.template.builtin import load_template
from jghand_engine.template.subdivision import Subdivision
from jghand_engine.template.surface import directed_edges, enclosed_volume, is_closed

OCTAHEDRON = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
FACES = np.array([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
TETRAHEDRON = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


@pytest.fixture(scope="module")
def hand():
    template = load_template()
    return template, Subdivision.of(template.faces, template.face_uv, 2)


def test_the_hand_becomes_a_finer_closed_surface_of_the_same_kind(hand):
    template, fine = hand
    count = len(fine.corner)
    assert len(fine.faces) == 16 * len(template.faces)
    assert is_closed(fine.faces)
    assert count - 3 * len(fine.faces) // 2 + len(fine.faces) == 2
    np.testing.assert_allclose(np.asarray(fine.matrix.sum(1)), 1, atol=1e-12)
    before, after = (enclosed_volume(v, f) for v, f in ((template.vertices_m, template.faces),
                                                        (fine.matrix @ template.vertices_m, fine.faces)))  # fmt: skip
    # it shrinks a little, as Loop's does: observed 0.979
    assert 0.96 < after / before < 1


def test_an_octahedron_becomes_round_and_no_face_turns_over():
    fine = Subdivision.of(FACES, np.zeros((8, 3, 2)), 3)
    vertices = fine.matrix @ OCTAHEDRON
    radius = np.linalg.norm(vertices, axis=1)
    # Loop's own limit is no sphere: observed 1.11
    assert radius.max() / radius.min() < 1.2
    a, b, c = (vertices[fine.faces[:, k]] for k in range(3))
    assert ((unit(np.cross(b - a, c - a)) * unit(a + b + c)).sum(1) > 0.9).all()


@pytest.mark.parametrize(
    ("vertices", "faces", "shrunk", "of_ends"),
    [
        (OCTAHEDRON, FACES, 33 / 64, 3 / 8),
        (np.array([[1.0, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]), TETRAHEDRON, 1 / 4, 1 / 4),
    ],
)
def test_vertices_and_edges_go_where_loop_has_them(vertices, faces, shrunk, of_ends):
    """By hand: of n neighbors a vertex takes 5/8 - (3/8 + cos(2 pi / n) / 4)^2, an edge 1/8 of each corner across."""
    fine, count = Subdivision.of(faces, np.zeros((len(faces), 3, 2)), 1).matrix @ vertices, len(vertices)
    np.testing.assert_allclose(fine[:count], shrunk * vertices, atol=1e-15)
    ends = np.unique(np.sort(directed_edges(faces), axis=1), axis=0)
    expected = of_ends * vertices[ends].sum(axis=1)
    np.testing.assert_allclose(np.unique(fine[count:], axis=0), np.unique(expected, axis=0), atol=1e-15)


def test_texture_coordinates_stay_within_their_coarse_face_and_keep_their_turn(hand):
    template, fine = hand

    def double_area(uv):
        return np.linalg.det(uv[:, 1:] - uv[:, :1])

    parts = double_area(fine.face_uv).reshape(-1, 16)
    np.testing.assert_allclose(parts, np.repeat(double_area(template.face_uv)[:, None] / 16, 16, 1), atol=1e-12)


def test_each_vertex_has_a_corner_that_is_its_own(hand):
    fine = hand[1]
    np.testing.assert_array_equal(fine.faces.reshape(-1)[fine.corner], np.arange(len(fine.corner)))


def test_a_place_in_the_texture_is_found_on_the_fine_faces(hand):
    template, fine = hand
    rng = np.random.default_rng(0)
    face, shares = rng.integers(0, len(template.faces), 300), rng.dirichlet(np.ones(3), 300)
    finer, parts = fine.places(face, shares)
    np.testing.assert_array_equal(finer // 16, face)
    assert parts.min() > -1e-12
    wanted, came = (np.einsum("nk,nkc->nc", s, uv[f]) for s, uv, f in ((shares, template.face_uv, face),
                                                                       (parts, fine.face_uv, finer)))  # fmt: skip
    np.testing.assert_allclose(came, wanted, atol=1e-12)
