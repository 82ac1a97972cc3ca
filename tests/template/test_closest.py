"""The closest point against what makes it the closest, and the search for it against plain loops."""

import itertools

import numpy as np
import pytest
import trimesh

from jghand_engine.template import closest
from jghand_engine.template.builtin import load_template
from jghand_engine.template.closest import Surface, closest_on_triangle

HAND = load_template()
TETRAHEDRON = np.array([[0, 1, 2], [0, 3, 1], [0, 2, 3], [1, 3, 2]])
OCTAHEDRON_M = 0.01 * np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]])


def octahedron() -> Surface:
    """Its corners lie on the axes, so the normal at each is the axis."""
    faces = []
    for signs in itertools.product((0, 3), repeat=3):
        corners = [axis + sign for axis, sign in enumerate(signs)]
        faces.append(corners if sum(sign == 3 for sign in signs) % 2 == 0 else corners[::-1])
    return Surface(OCTAHEDRON_M, np.array(faces))


def triangles(count: int) -> np.ndarray:
    """Of every shape: ordinary, obtuse, long and thin, nearly and quite without area, in all sizes."""
    random = np.random.default_rng(0)
    corners = random.normal(size=(count, 3, 3))
    thin = 10.0 ** random.uniform(-6, 0, (count, 1))
    corners[:, 2] = (
        corners[:, 0] + random.uniform(-2, 3, (count, 1)) * (corners[:, 1] - corners[:, 0]) + thin * corners[:, 2]
    )
    corners[::50, 2] = corners[::50, :2].mean(1)
    corners[1::50, 1] = corners[1::50, 0]
    corners[2::50] = corners[2::50, :1]
    return corners * 10.0 ** random.uniform(-3, 2, (count, 1, 1))


def test_no_point_of_a_triangle_is_nearer_than_the_closest():
    """p is the closest point of a convex set exactly when no corner lies beyond the plane through p across the way."""
    random = np.random.default_rng(1)
    corners = triangles(6000)
    size = np.linalg.norm(corners - corners.mean(1, keepdims=True), axis=2).max(1) + 1e-9
    points = corners.mean(1) + size[:, None] * random.normal(size=(6000, 3)) * random.choice([0.1, 1, 5], (6000, 1))
    bary, squared = closest_on_triangle(points, corners)
    assert (bary >= 0).all()
    np.testing.assert_allclose(bary.sum(1), 1, atol=1e-12)
    found = np.einsum("nk,nkc->nc", bary, corners)
    np.testing.assert_allclose(squared, ((points - found) ** 2).sum(1), rtol=1e-12)
    beyond = np.einsum("nkc,nc->nk", corners - found[:, None], points - found).max(1) / (size * np.sqrt(squared))
    # of triangles with hardly an area, the inside is only nearly found: worst observed 8.5e-7; without any, 1.4e-14
    assert beyond.max() < 1e-6
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    assert beyond[area > 1e-3 * size**2].max() < 4e-10  # worst observed 2.9e-10
    assert beyond[area < 1e-15 * size**2].max() < 1e-13


def test_the_weights_of_what_is_beside_a_triangle_are_zero_at_the_border():
    """Not nearly: they say which edge or corner it is."""
    random = np.random.default_rng(2)
    corners = random.normal(size=(3000, 3, 3))
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    weights = random.normal(size=(3000, 3)) + 1 / 3
    weights /= weights.sum(1, keepdims=True)
    points = np.einsum("nk,nkc->nc", weights, corners) + random.normal(size=(3000, 1)) * normal
    bary, _ = closest_on_triangle(points, corners)
    inside = (weights > 0).all(1)
    assert 200 < inside.sum() < 2000
    np.testing.assert_allclose(bary[inside], weights[inside], atol=1e-9)
    assert (bary[inside] > 0).all()
    assert ((bary[~inside] == 0).sum(1) >= 1).all()


def test_normals_are_mixed_from_those_of_the_corners():
    surface = octahedron()
    random = np.random.default_rng(3)
    face = random.integers(8, size=200)
    bary = random.dirichlet([1, 1, 1], 200)
    place = np.einsum("nk,nkc->nc", bary, surface.corners_m[face])
    # on the octahedron the place is the mixture of the axes too
    np.testing.assert_allclose(
        surface.normals(face, bary), place / np.linalg.norm(place, axis=1, keepdims=True), atol=1e-14
    )


def test_where_the_normals_of_the_corners_cancel_the_face_s_own_is_taken():
    """Two triangles back to back: at every corner one looks up and one down."""
    surface = Surface(np.array([[0.0, 0, 0], [0.01, 0, 0], [0, 0.01, 0]]), np.array([[0, 1, 2], [0, 2, 1]]))
    with np.errstate(all="raise"):
        normals = surface.normals(np.array([0, 1]), np.full((2, 3), 1 / 3))
    np.testing.assert_array_equal(normals, [[0, 0, 1], [0, 0, -1]])


def test_a_point_on_the_surface_has_no_distance():
    surface = octahedron()
    points = surface.corners_m.mean(1)
    near = surface.closest(points)
    np.testing.assert_allclose(near.signed_m, 0, atol=1e-15)
    np.testing.assert_allclose(near.point_m, points, atol=1e-15)
    assert np.array_equal(near.face, np.arange(8))


def test_the_distance_to_an_octahedron_is_that_to_its_planes_inside_and_to_its_corners_beyond_them():
    surface = octahedron()
    inside = np.random.default_rng(4).uniform(-0.003, 0.003, (100, 3))
    depth = (0.01 - np.abs(inside).sum(1)) / np.sqrt(3)
    np.testing.assert_allclose(surface.closest(inside).signed_m, -depth, rtol=1e-12)
    beyond = 3 * OCTAHEDRON_M + 0.001
    near = surface.closest(beyond)
    np.testing.assert_allclose(near.point_m, OCTAHEDRON_M, atol=1e-15)
    np.testing.assert_allclose(near.signed_m, np.linalg.norm(beyond - OCTAHEDRON_M, axis=1), rtol=1e-14)


# ---- the search -----------------------------------------------------------------------------------------------------


def splinter() -> Surface:
    """Long and thin, askew to all axes."""
    along, side = np.array([1.0, 1, 1]) / np.sqrt(3), np.array([1.0, -1, 0]) / np.sqrt(2)
    end = 0.0054 * along + 1e-5 * np.array([np.zeros(3), np.cross(along, side), side])
    return Surface(np.concatenate([np.zeros((1, 3)), end]), TETRAHEDRON)


@pytest.mark.parametrize("surface", [Surface(HAND.vertices_m, HAND.faces), splinter()], ids=["hand", "splinter"])
def test_a_rough_distance_is_too_large_by_a_piece_at_most(surface):
    corners = surface.corners_m[::8, 0]
    away = np.random.default_rng(10).normal(scale=0.01, size=corners.shape)
    points = np.concatenate([corners, corners + away])
    face, rough = surface.rough(points)
    exact = np.abs(surface.closest(points).signed_m)
    assert (rough >= exact - 1e-15).all()
    assert (rough <= exact + surface.piece_radius_m + 1e-15).all()
    assert surface.piece_radius_m <= closest.CLOSEST_PIECE_RADIUS_M
    _, squared = closest_on_triangle(points, surface.corners_m[face])
    assert (np.sqrt(squared) <= rough + 1e-15).all()


def test_a_large_face_is_found_behind_many_small_ones_whose_middles_are_nearer():
    ball = trimesh.creation.icosphere(subdivisions=1, radius=5e-5)
    wedge_m = np.array([[0.0, 0, 0], [2.4e-3, 0, 0], [0, 2.4e-3, 0], [0, 0, -1e-3]]) - np.array([1e-4, 1e-4, 0])
    surface = Surface(
        np.concatenate([ball.vertices + np.array([0, 0, 2.15e-3]), wedge_m]),
        np.concatenate([ball.faces, TETRAHEDRON + len(ball.vertices)]),
    )
    near = surface.closest(np.array([[0, 0, 1e-3]]))
    np.testing.assert_allclose(near.point_m, [[0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(near.signed_m, 1e-3)
