"""Between textures and the surface: attributes laid out in UV, and textures looked up. Texture row = 1 - v."""

from __future__ import annotations

import numpy as np

# laying out textures: triangles are widened by this part of themselves, so that shared edges leave no gap; twice the
# smallest area that is drawn, texels^2
UV_EDGE_SLACK = 0.02
UV_DOUBLE_AREA_MIN_PX2 = 1e-12


def rasterize_uv(face_uv: np.ndarray, corner_values: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Lays per-corner values out in UV space.

    face_uv (F, 3, 2), corner_values (F, 3, C) -> values (size, size, C) float64 with row = 1 - v, texel centers at
    ((column + 0.5) / size, 1 - (row + 0.5) / size), and a bool mask (size, size) of the covered texels.
    """
    values = np.zeros((size, size, corner_values.shape[-1]))
    covered = np.zeros((size, size), dtype=bool)
    corners_px = np.stack([face_uv[..., 0] * size, (1 - face_uv[..., 1]) * size], axis=-1).astype(float) - 0.5
    for corners, value in zip(corners_px, np.asarray(corner_values, dtype=float), strict=True):
        edge1, edge2 = corners[1] - corners[0], corners[2] - corners[0]
        double_area = edge1[0] * edge2[1] - edge2[0] * edge1[1]
        if abs(double_area) < UV_DOUBLE_AREA_MIN_PX2:
            continue
        low = np.clip(np.floor(corners.min(axis=0)).astype(int) - 1, 0, size - 1)
        high = np.clip(np.ceil(corners.max(axis=0)).astype(int) + 2, 1, size)
        column, row = np.meshgrid(np.arange(low[0], high[0]), np.arange(low[1], high[1]))
        x, y = column - corners[0, 0], row - corners[0, 1]
        b1 = (x * edge2[1] - edge2[0] * y) / double_area
        b2 = (edge1[0] * y - x * edge1[1]) / double_area
        b0 = 1 - b1 - b2
        inside = (b0 >= -UV_EDGE_SLACK) & (b1 >= -UV_EDGE_SLACK) & (b2 >= -UV_EDGE_SLACK)
        bary = np.stack([b0[inside], b1[inside], b2[inside]], axis=1)
        values[row[inside], column[inside]] = bary @ value
        covered[row[inside], column[inside]] = True
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
