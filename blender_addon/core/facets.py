# SPDX-License-Identifier: GPL-3.0-or-later
"""Small triangles on which Cycles bakes light: those of a probe, and those above points of the skin, which say how much
light falls there and how that turns with the normal. No bpy.

Skin's own normals turn between two points, and a mean over neighbors must not round off what they see: so a point has
facets that look along its normal, and others that are tilted away from it, and what is kept is the field of light
E(n) = a + n @ b that fits them.
"""

from __future__ import annotations

import numpy as np

# a facet lies so far above the skin, meters: faces of the hand's surface are flat, and rays must not begin below the
# next one; and reaches so far from its middle: a tilted one stays above the skin
LIFT_M, RADIUS_M = 1e-3, 4e-4
# by how much facets are tilted: as much as skin turns within a centimeter
TILT_RAD = 0.7
# two look along the normal: what they see counts for more than how it turns
_UP, _TILTED = 2, 3
LOOKS = _UP + _TILTED


def triangles(place: np.ndarray, normal: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
    """(N, 3, 3) corners of even triangles around places (N, 3) that face unit normals (N, 3)."""
    side, across = _sides(normal)
    turn = 2 * np.pi * np.arange(3)[:, None, None] / 3
    corners = np.cos(turn) * side + np.sin(turn) * across
    return (place + np.reshape(radius, (-1, 1)) * corners).swapaxes(0, 1)


def above_skin(points_m: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N LOOKS, 3, 3) corners, meters, of the facets above points of the skin (N, 3) with unit normals (N, 3)."""
    looks = np.einsum("kl,lna->nka", _looks(), np.stack([*_sides(normals), normals]))
    places = (points_m + LIFT_M * normals)[:, None] + np.zeros_like(looks)
    return triangles(places.reshape(-1, 3), looks.reshape(-1, 3), RADIUS_M)


def fields(radiance: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(N, 4, 3) a, and the rows of b, W/m2, of the light at points with normals (N, 3), from the radiance (N LOOKS, 3)
    that their white facets throw back."""
    fit = np.linalg.pinv(np.concatenate([np.ones((LOOKS, 1)), _looks()], 1))
    local = np.einsum("fk,nkc->nfc", fit, np.pi * radiance.reshape(-1, LOOKS, 3))
    axes = np.stack([*_sides(normals), normals], 1)
    return np.concatenate([local[:, :1], np.einsum("nla,nlc->nac", axes, local[:, 1:])], 1)


def _looks() -> np.ndarray:
    """(LOOKS, 3) where the facets of a point look, along its sides and its normal."""
    turn = 2 * np.pi * np.arange(_TILTED) / _TILTED
    tilted = np.stack([np.cos(turn), np.sin(turn)], 1) * np.sin(TILT_RAD)
    return np.concatenate(
        [np.tile([0, 0, 1], (_UP, 1)), np.pad(tilted, ((0, 0), (0, 1)), constant_values=np.cos(TILT_RAD))]
    )


def _sides(normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two (N, 3) unit vectors at right angles to normals and to each other."""
    side = np.cross(normal, np.where(np.abs(normal[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]))
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    return side, np.cross(normal, side)
