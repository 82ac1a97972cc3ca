"""Skin weights as a field in space: known at the surface, harmonic everywhere else.

Gaussians lie off the surface. The weight of the nearest vertex would jump half-way between two fingers; the harmonic
(Laplace) extension of the surface's weights does not. The field is canonical: look a Gaussian up once, never per frame.
METHOD 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch.nn import functional

from jghand_engine.template.closest import Surface
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.weights import without_crumbs

# weight field: voxel edge, margin around the surface, sweeps per level, levels (METHOD 3.4)
FIELD_VOXEL_M = 0.003
FIELD_MARGIN_M = 0.012
FIELD_SWEEPS = 30
FIELD_LEVELS = 4


@dataclass(frozen=True)
class WeightField:
    """Bone weights on a grid of voxels, to be interpolated.

    grid:   (1, 21, X, Y, Z) float32; sums to 1 over the bones in every voxel
    low_m:  (3,) float64, center of the first voxel, canonical frame
    high_m: (3,) float64, center of the last voxel
    """

    grid: torch.Tensor
    low_m: torch.Tensor
    high_m: torch.Tensor

    @classmethod
    def build(cls, template: HandTemplate, *, voxel_m: float = FIELD_VOXEL_M) -> WeightField:
        """Fixes the voxels within one voxel of the surface at the weights of the closest skin and fills the rest."""
        multiple = 2 ** (FIELD_LEVELS - 1)
        low = template.vertices_m.min(axis=0) - FIELD_MARGIN_M
        high = template.vertices_m.max(axis=0) + FIELD_MARGIN_M
        # a multiple of 2^(levels - 1) voxels, so that every coarser grid has whole voxels
        counts = (np.ceil((high - low) / voxel_m / multiple).astype(int) + 1) * multiple
        axes = [low[k] + voxel_m * np.arange(counts[k]) for k in range(3)]
        centers = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
        seed, fixed = _seed(template, centers, voxel_m)
        shape = [int(n) for n in counts]
        grid = torch.from_numpy(seed.astype(np.float32).T.copy()).reshape(1, -1, *shape)
        grid = _harmonic(grid, torch.from_numpy(fixed).reshape(1, 1, *shape), FIELD_LEVELS).clamp_min(0)
        return cls(
            grid=grid / grid.sum(dim=1, keepdim=True),
            low_m=torch.from_numpy(low),
            high_m=torch.from_numpy(low + (counts - 1) * voxel_m),
        )

    def query(self, points_m: torch.Tensor | np.ndarray) -> torch.Tensor:
        """Weights (N, 21) float32, rows summing to 1, at points (N, 3); outside the grid those of its border.

        Piecewise differentiable with respect to the points. Weights below WEIGHT_MIN are dropped.
        """
        points = torch.as_tensor(points_m, dtype=torch.float64)
        place = (2 * (points - self.low_m) / (self.high_m - self.low_m) - 1).to(self.grid.dtype)
        # grid_sample names the last axis x, so z, y, x; corners are aligned because low and high are voxel centers
        found = functional.grid_sample(
            self.grid, place.flip(-1).view(1, -1, 1, 1, 3), mode="bilinear", padding_mode="border", align_corners=True
        )
        return without_crumbs(found.view(self.grid.shape[1], -1).T)


def _seed(template: HandTemplate, centers: np.ndarray, voxel_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Weights (N, 21) to start from and which voxels (N,) are fixed.

    Near the surface: those of the closest point. Elsewhere only a first guess that the filling replaces.
    """
    surface = Surface(template.vertices_m, template.faces)
    corner_weights = template.bone_weights[template.faces]
    face, rough = surface.rough(centers)
    seed = corner_weights[face].mean(axis=1)
    close = np.flatnonzero(rough <= voxel_m + surface.piece_radius_m)
    near = surface.closest(centers[close])
    seed[close] = np.einsum("nk,nkj->nj", near.barycentric, corner_weights[near.face])
    fixed = np.zeros(len(centers), dtype=bool)
    fixed[close] = np.abs(near.signed_m) <= voxel_m
    return seed, fixed


def _harmonic(weights: torch.Tensor, fixed: torch.Tensor, levels: int) -> torch.Tensor:
    """Solves Laplace's equation for the voxels that are not fixed: first on a coarser grid, then by Jacobi sweeps."""
    if levels > 1:
        share = functional.avg_pool3d(fixed.float(), 2)
        known = functional.avg_pool3d(weights * fixed, 2) / share.clamp_min(1 / 8)
        coarse_fixed = share > 0
        coarse = _harmonic(
            torch.where(coarse_fixed, known, functional.avg_pool3d(weights, 2)), coarse_fixed, levels - 1
        )
        finer = functional.interpolate(coarse, size=weights.shape[2:], mode="trilinear", align_corners=False)
        weights = torch.where(fixed, weights, finer)
    start = weights
    for _ in range(FIELD_SWEEPS):
        # the border repeats itself: no flow out of the box
        p = functional.pad(weights, (1,) * 6, mode="replicate")
        mean = p[:, :, 2:, 1:-1, 1:-1] + p[:, :, :-2, 1:-1, 1:-1]
        mean += p[:, :, 1:-1, 2:, 1:-1]
        mean += p[:, :, 1:-1, :-2, 1:-1]
        mean += p[:, :, 1:-1, 1:-1, 2:]
        mean += p[:, :, 1:-1, 1:-1, :-2]
        weights = torch.where(fixed, start, mean / 6)
    return weights
