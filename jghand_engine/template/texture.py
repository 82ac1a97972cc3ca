"""Between textures and the surface: attributes laid out in UV, and textures looked up. Texture row = 1 - v."""

from __future__ import annotations

import numpy as np

# laying out textures: triangles are widened by this part of themselves, so that shared edges leave no gap; twice the
# smallest area that is drawn, texels^2
UV_EDGE_SLACK = 0.02
UV_DOUBLE_AREA_MIN_PX2 = 1e-12
# texels of faces' boxes that are looked at together, about: what that takes of memory
TEXELS_MAX = 500_000


def rasterize_uv(face_uv: np.ndarray, corner_values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Lays per-corner values out in UV space.

    face_uv (F, 3, 2), corner_values (F, 3, C) -> values (size, size, C) float64 with row = 1 - v, texel centers at
    ((column + 0.5) / size, 1 - (row + 0.5) / size), and a bool mask (size, size) of the covered texels.
    """
    values = np.zeros((size, size, corner_values.shape[-1]))
    covered = np.zeros((size, size), dtype=bool)
    corners_px = np.stack([face_uv[..., 0] * size, (1 - face_uv[..., 1]) * size], axis=-1).astype(float) - 0.5
    edge1, edge2 = (corners_px[:, corner] - corners_px[:, 0] for corner in (1, 2))
    double_area = edge1[:, 0] * edge2[:, 1] - edge2[:, 0] * edge1[:, 1]
    # the texels that a face may touch: a box
    low = np.clip(np.floor(corners_px.min(axis=1)).astype(int) - 1, 0, size - 1)
    width, height = (np.clip(np.ceil(corners_px.max(axis=1)).astype(int) + 2, 1, size) - low).T
    drawn = np.flatnonzero(np.abs(double_area) >= UV_DOUBLE_AREA_MIN_PX2)
    done = np.cumsum((width * height)[drawn])
    # in the order of the faces: where two meet, the later one stays
    for some in np.split(drawn, np.searchsorted(done, np.arange(TEXELS_MAX, done[-1] if len(done) else 0, TEXELS_MAX))):
        texels = (width * height)[some]
        face = some.repeat(texels)
        place = np.arange(len(face)) - (np.cumsum(texels) - texels).repeat(texels)
        row, column = low[face, 1] + place // width[face], low[face, 0] + place % width[face]
        x, y = column - corners_px[face, 0, 0], row - corners_px[face, 0, 1]
        b1 = (x * edge2[face, 1] - edge2[face, 0] * y) / double_area[face]
        b2 = (edge1[face, 0] * y - x * edge1[face, 1]) / double_area[face]
        bary = np.stack([1 - b1 - b2, b1, b2], axis=1)
        inside = (bary >= -UV_EDGE_SLACK).all(axis=1)
        row, column = row[inside], column[inside]
        values[row, column] = np.einsum("tk,tkc->tc", bary[inside], corner_values[face[inside]])
        covered[row, column] = True
    return values, covered


def sample_bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Looks `texture` (H, W, C) up at `uv` (..., 2), row = 1 - v, border texels repeated -> (..., C) float64."""
    height, width = texture.shape[:2]
    x = np.clip(uv[..., 0] * width - 0.5, 0, width - 1)
    y = np.clip((1 - uv[..., 1]) * height - 0.5, 0, height - 1)
    left, top = np.floor(x).astype(int), np.floor(y).astype(int)
    right, bottom = np.minimum(left + 1, width - 1), np.minimum(top + 1, height - 1)
    fx, fy = (x - left)[..., None], (y - top)[..., None]
    upper = texture[top, left] * (1 - fx) + texture[top, right] * fx
    lower = texture[bottom, left] * (1 - fx) + texture[bottom, right] * fx
    return upper * (1 - fy) + lower * fy
