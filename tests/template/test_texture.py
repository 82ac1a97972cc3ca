"""Textures laid out and looked up, against plain loops and SciPy."""

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from jghand_engine.template.texture import UV_EDGE_SLACK, rasterize_uv, sample_bilinear


def slow_layout(face_uv: np.ndarray, corner_values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Every texel's center against every triangle; the last one that it lies in, or nearly, counts."""
    values, covered = np.zeros((size, size, corner_values.shape[-1])), np.zeros((size, size), dtype=bool)
    for uv, value in zip(face_uv, corner_values, strict=True):
        system = np.concatenate([uv.T, np.ones((1, 3))])
        if abs(np.linalg.det(system)) * size**2 < 1e-12:
            continue
        for row in range(size):
            for column in range(size):
                center = np.array([(column + 0.5) / size, 1 - (row + 0.5) / size, 1.0])
                bary = np.linalg.solve(system, center)
                if bary.min() >= -UV_EDGE_SLACK:
                    values[row, column], covered[row, column] = bary @ value, True
    return values, covered


@pytest.mark.parametrize("seed", range(4))
def test_values_are_laid_out_as_texel_by_texel(seed: int):
    """Triangles of both orientations, over each other, over the border, beyond it and without area."""
    random = np.random.default_rng(seed)
    middle = random.uniform(0, 1, (12, 1, 2))
    face_uv = middle + random.normal(scale=0.15, size=(12, 3, 2))
    face_uv[5, 2] = face_uv[5, 0]
    face_uv[6:8] += np.array([[[2.0, 0.0]], [[0.0, -2.0]]])
    corner_values = random.normal(size=(12, 3, 2))
    got, want = (layout(face_uv, corner_values, 24) for layout in (rasterize_uv, slow_layout))
    assert np.array_equal(got[1], want[1])
    assert 50 < got[1].sum() < 300
    np.testing.assert_allclose(got[0], want[0], atol=1e-11)


@pytest.mark.parametrize("shape", [(5, 9), (1, 1), (1, 6), (8, 2)])
def test_lookups_are_those_of_scipy(shape: tuple[int, int]):
    random = np.random.default_rng(0)
    texture = random.normal(size=(*shape, 3))
    uv = random.uniform(-0.2, 1.2, (20, 30, 2))
    uv[0] = [0, 1]
    uv[1, :, 0] = (np.arange(30) % shape[1] + 0.5) / shape[1]
    places = [(1 - uv[..., 1]) * shape[0] - 0.5, uv[..., 0] * shape[1] - 0.5]
    expected = [map_coordinates(texture[..., channel], places, order=1, mode="nearest") for channel in range(3)]
    np.testing.assert_allclose(sample_bilinear(texture, uv), np.stack(expected, -1), atol=1e-12)
