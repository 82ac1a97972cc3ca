"""Several hands in one picture: the nearer one over the farther one, pixel by pixel."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np


def composite_by_depth(rgba: Sequence[np.ndarray], depth_m: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Premultiplied (H, W, 4) pictures and (H, W) depths (0 = nothing) of the same view -> one of each.

    Exact where hands do not interpenetrate within a pixel. A pixel without a depth (alpha below the depth threshold:
    the soft rim) counts as lying behind everything, so that a rim never hides another hand's skin.
    """
    if len(rgba) == 1:
        return rgba[0], depth_m[0]
    distance = np.stack([np.where(d > 0, d, np.inf) for d in depth_m])
    order = np.argsort(distance, axis=0, kind="stable")
    layers = np.take_along_axis(np.stack(rgba), order[..., None], axis=0)
    picture = layers[-1]
    for layer in layers[-2::-1]:
        picture = layer + (1.0 - layer[..., 3:]) * picture
    nearest = np.min(distance, axis=0)
    return picture.astype(np.float32), np.where(np.isfinite(nearest), nearest, 0.0).astype(np.float32)
