"""The facets on which light is baked: where they look, and what is made of what they see."""

from __future__ import annotations

import numpy as np

from blender_addon.core import worlds as facets


def unit_vectors(count: int) -> np.ndarray:
    vectors = np.random.default_rng(0).standard_normal((count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def looks_of(corners: np.ndarray) -> np.ndarray:
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return across / np.linalg.norm(across, axis=1, keepdims=True)


def test_triangles_lie_around_their_places_and_face_their_normals():
    places, normals = np.random.default_rng(1).uniform(-1, 1, (50, 3)), unit_vectors(50)
    corners = facets.triangles(places, normals, np.linspace(0.1, 0.2, 50))
    np.testing.assert_allclose(corners.mean(1), places, atol=1e-12)
    np.testing.assert_allclose(looks_of(corners), normals, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(corners - places[:, None], axis=-1)[:, 0], np.linspace(0.1, 0.2, 50))


def test_facets_stay_above_the_skin_of_their_point():
    points, normals = np.zeros((50, 3)), unit_vectors(50)
    corners = facets.above_skin(points, normals)
    height_m = np.einsum("nkca,na->nkc", corners.reshape(50, facets.LOOKS, 3, 3), normals)
    assert height_m.min() > 0.5e-3
    assert height_m.max() < 1.5e-3


def test_light_that_turns_with_the_normal_is_found_as_it_is():
    """A white facet throws back a pi-th of what falls on it."""
    normals, field = unit_vectors(20), np.random.default_rng(2).standard_normal((20, 4, 3))
    looks = looks_of(facets.above_skin(np.zeros((20, 3)), normals)).reshape(20, facets.LOOKS, 3)
    light = field[:, None, 0] + np.einsum("nka,nac->nkc", looks, field[:, 1:])
    np.testing.assert_allclose(facets.fields(light.reshape(-1, 3) / np.pi, normals), field, atol=1e-10)
