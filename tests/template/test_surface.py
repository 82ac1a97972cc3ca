"""Closed surfaces: closing them, normals, the closest point and its side, textures."""

import numpy as np
import pytest
import trimesh

from jghand_engine.errors import InputError
from jghand_engine.template.builtin import load_template
from jghand_engine.template.closest import Surface, closest_on_triangle
from jghand_engine.template.surface import (
    boundary_loop,
    disk_uv,
    enclosed_volume,
    face_normals,
    fan_faces,
    is_closed,
    one_uv_each,
    vertex_normals,
)
from jghand_engine.template.texture import rasterize_uv, sample_bilinear


@pytest.fixture(scope="module")
def hand():
    return load_template()


@pytest.fixture(scope="module")
def surface(hand):
    return Surface(hand.vertices_m, hand.faces)


def points_around(hand, count, reach_m=0.01):
    rng = np.random.default_rng(0)
    vertices = hand.vertices_m[rng.integers(len(hand.vertices_m), size=count)]
    return vertices + rng.normal(scale=reach_m / 2, size=(count, 3))


def test_the_closest_point_is_that_of_trying_every_face(hand, surface):
    points = points_around(hand, 200)
    found = surface.closest(points)
    count = len(hand.faces)
    _, squared = closest_on_triangle(np.repeat(points, count, axis=0), np.tile(surface.corners_m, (200, 1, 1)))
    np.testing.assert_allclose(np.abs(found.signed_m), np.sqrt(squared.reshape(200, count).min(axis=1)), atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(points - found.point_m, axis=1), np.abs(found.signed_m), atol=1e-15)


def test_inside_is_negative(hand, surface):
    """Against the winding number, which needs no normals."""
    points = points_around(hand, 500)
    corners = surface.corners_m[None] - points[:, None, None]
    length = np.linalg.norm(corners, axis=3)
    a, b, c = (corners[:, :, k] for k in range(3))
    volume = np.einsum("nfc,nfc->nf", a, np.cross(b, c))
    dots = [np.einsum("nfc,nfc->nf", p, q) for p, q in ((a, b), (b, c), (c, a))]
    below = length.prod(axis=2) + dots[0] * length[..., 2] + dots[1] * length[..., 0] + dots[2] * length[..., 1]
    winding = 2 * np.arctan2(volume, below).sum(axis=1) / (4 * np.pi)
    assert np.array_equal(winding > 0.5, surface.closest(points).signed_m < 0)


def test_the_side_is_right_beyond_sharp_edges_and_corners():
    """There the normal of a face says the wrong side: its neighbor looks the other way."""
    sharp = np.array([[-0.01, 0, 0], [0.01, 0.001, 0], [0.01, -0.001, 0.001], [0.009, 0, -0.001]])
    faces = np.array([[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]])
    surface = Surface(sharp, faces[:, ::-1])
    corners = sharp[faces[:, ::-1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.einsum("fc,fc->f", normals, corners.mean(axis=1) - sharp.mean(axis=0)) > 0).all()
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.uniform(-0.012, 0.012, (3000, 3)), rng.dirichlet([1] * 4, 500) @ sharp])
    inside = (np.einsum("fc,nfc->nf", normals, points[:, None] - corners[None, :, 0]) < 0).all(axis=1)
    assert np.array_equal(surface.closest(points).signed_m < 0, inside)
    assert 500 <= inside.sum() < 1000


def test_an_opening_is_found_and_closed_in_the_faces_direction(hand):
    skin = hand.faces[: hand.skin_face_count]
    assert not is_closed(skin)
    loop = boundary_loop(skin)
    assert loop[0] == loop.min()
    assert is_closed(np.concatenate([skin, fan_faces(loop, len(hand.vertices_m) - 1)]))


def test_surfaces_without_exactly_one_opening_are_refused(hand):
    beside = np.flatnonzero((hand.faces == hand.faces[0, 0]).any(axis=1))
    # none, one, two that are apart, and two that touch at a vertex
    for gone in ([], [0, 1500], beside[[0, len(beside) // 2]]):
        with pytest.raises(InputError, match="one loop"):
            boundary_loop(np.delete(hand.faces, gone, axis=0))


def test_a_fan_is_laid_out_as_a_disk():
    uv = disk_uv(7, (0.3, 0.6), 0.2)
    after, ring, center = (uv - (0.3, 0.6)).transpose(1, 0, 2)
    np.testing.assert_allclose(np.linalg.norm(ring, axis=1), 0.2)
    np.testing.assert_array_equal(after, np.roll(ring, -1, axis=0))
    np.testing.assert_array_equal(center, 0)
    # each spans a seventh of the circle, all turned alike
    np.testing.assert_allclose(np.linalg.det(np.stack([ring, after], axis=1)), 0.2**2 * np.sin(2 * np.pi / 7))


def test_vertices_at_seams_of_the_texture_are_doubled_and_no_others(hand):
    vertex, uv, faces = one_uv_each(hand.faces, hand.face_uv)
    np.testing.assert_array_equal(vertex[faces], hand.faces)
    np.testing.assert_array_equal(uv[faces], hand.face_uv)
    assert len(np.unique(np.column_stack([vertex, uv]), axis=0)) == len(vertex)


def test_closed_means_every_edge_once_in_each_direction():
    tetrahedron = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert is_closed(tetrahedron)
    assert not is_closed(np.concatenate([tetrahedron, tetrahedron]))  # every edge twice
    assert not is_closed(tetrahedron[:3])
    turned = tetrahedron.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(turned)


def test_volume_and_normals_of_a_box():
    box = trimesh.creation.box((0.2, 0.3, 0.5))
    vertices, faces = np.asarray(box.vertices), np.asarray(box.faces)
    assert enclosed_volume(vertices + 5, faces) == pytest.approx(0.03)
    assert enclosed_volume(vertices, faces[:, ::-1]) == pytest.approx(-0.03)
    normals = face_normals(vertices, faces)
    outwards = vertices[faces].mean(axis=1)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
    np.testing.assert_allclose(np.abs(normals).max(axis=1), 1)
    assert (np.einsum("fc,fc->f", normals, outwards) > 0).all()
    # at a corner of a box the three planes weigh the same, however its sides are cut into triangles
    np.testing.assert_allclose(vertex_normals(vertices, faces), np.sign(vertices) / np.sqrt(3), atol=1e-15)


def test_a_texture_laid_out_and_looked_up_gives_back_its_values(hand):
    skin = hand.skin_face_count
    face_uv, corners = hand.face_uv[:skin], hand.vertices_m[hand.faces[:skin]]
    texture, covered = rasterize_uv(face_uv, corners, 1024)
    assert covered.any()
    # away from the island's rim a texel is interpolated between covered ones
    center_uv = face_uv.mean(axis=1)
    looked_up, full = sample_bilinear(texture, center_uv), sample_bilinear(covered[..., None] * 1.0, center_uv)[:, 0]
    error = np.linalg.norm(looked_up - corners.mean(axis=1), axis=1)
    assert (full == 1).mean() > 0.9
    # a small face shares texels with others of another slope: worst observed 0.10 mm, where a texel is 0.24 mm
    assert error[full == 1].max() < 1.1e-4


def test_texture_rows_run_from_the_top():
    texture = np.zeros((4, 4, 1))
    texture[0, 3] = 1
    assert sample_bilinear(texture, np.array([0.99, 0.99]))[0] == 1
    values, covered = rasterize_uv(np.array([[[0, 0.75], [0.5, 0.75], [0, 1.0]]]), np.ones((1, 3, 1)), 8)
    assert covered[:2].any()
    assert not covered[2:].any()
    assert values.max() == pytest.approx(1)
