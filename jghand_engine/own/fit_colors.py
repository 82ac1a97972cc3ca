"""Which color each Gaussian of a fit's hand has, by all pictures and poses as they stand, and the light it moves in."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from scipy.spatial import KDTree
from torch import Tensor

from jghand_engine.learn.light import harmonics
from jghand_engine.own.fit_surface import FitSurface, Kept, PosedBatch
from jghand_engine.own.fit_views import Sight
from jghand_engine.own.gather import SEEN_MIN_PX, counted, facing, mean_of_pixels

# a Gaussian that was seen less, by all pictures, takes its neighbors' color
SEEN_ENOUGH = 0.3
NEIGHBORS = 16
# rounds of albedo and light in turn; logarithms that differ by more than this count less and less
ROUNDS, ROBUST_SIGMA = 5, 0.12
# ridge of the light's harmonics, by degree: what pictures from one side do not say stays even
RIDGE = 40.0 * np.repeat([1.0, 1.0, 3.0, 9.0], [1, 3, 5, 7])
COLOR_MIN = 0.01


@dataclass(frozen=True)
class SkinColors:
    """albedo: (N, 3) logarithm · light: (16, 3) of the harmonics of normals before the camera, without their mean"""

    albedo: Tensor
    light: Tensor

    def of(self, normal: Tensor, shade: Tensor) -> Tensor:
        """(N, 3) colors of one pose. normal, shade: (N, 3)"""
        return (self.albedo + harmonics(normal) @ self.light.to(normal) + shade).exp()


def skin_colors(
    surface: FitSurface, posed: PosedBatch, kept: Kept, pictures: Sequence[Sight], factor: float
) -> SkinColors:
    """Of all pictures. posed: without gradients · factor: of the radii"""
    posed = PosedBatch(posed.position_m.float(), posed.normal.float(), posed.sigma_m.float())
    found = []
    for row, sight in enumerate(pictures):
        rgb = torch.zeros(len(surface), 3, requires_grad=True)
        drawn = surface.draw(posed, row, sight.view.camera, rgb, factor).rgb
        color, seen = mean_of_pixels(drawn, rgb, sight.rgb, sight.inside)
        squarely = facing(posed.normal[row], posed.position_m[row]).square()
        log_color = color.clamp(COLOR_MIN, 1).log() - kept.shade[row].float()
        found.append((log_color, seen * squarely * (seen > SEEN_MIN_PX)))
    logs, seen = (torch.stack(parts) for parts in zip(*found, strict=True))
    return _solved(logs, counted(seen), posed, surface)


def _solved(logs: Tensor, weight: Tensor, posed: PosedBatch, surface: FitSurface) -> SkinColors:
    """From logarithms of colors (F, N, 3) and how much each counts (F, N): albedo as a robust mean and light by least
    squares, in turn. The light's mean is 0: it is the albedo's."""
    functions = torch.stack([harmonics(normal) for normal in posed.normal])
    light, seen = torch.zeros(functions.shape[-1], 3), weight.sum(0)
    albedo, enough = torch.zeros(len(surface), 3), seen > SEEN_ENOUGH
    trust = weight[..., None].expand_as(logs)
    for _ in range(ROUNDS):
        left = logs - functions @ light
        for _ in range(2):
            albedo = (trust * left).sum(0) / trust.sum(0).clamp_min(1e-6)
            trust = weight[..., None] / (1 + ((left - albedo) / ROBUST_SIGMA) ** 2)
        light = torch.stack([_light(logs[..., c], functions, trust[..., c] * enough) for c in range(3)], -1)
    albedo = (trust * (logs - functions @ light)).sum(0) / trust.sum(0).clamp_min(1e-6)
    return SkinColors(_filled(albedo, seen, surface.hand.position_m), light)


def _light(logs: Tensor, functions: Tensor, weight: Tensor) -> Tensor:
    """(16,) of one channel, by what differs between pictures of the same Gaussian: its albedo drops out."""
    total = weight.sum(0).clamp_min(1e-6)
    functions = functions - (weight[..., None] * functions).sum(0) / total[:, None]
    logs = logs - (weight * logs).sum(0) / total
    weighted = (weight[..., None] * functions).flatten(0, 1)
    matrix = weighted.T @ functions.flatten(0, 1) + torch.from_numpy(np.diag(RIDGE)).to(weighted)
    light = torch.linalg.solve(matrix, weighted.T @ logs.flatten())
    return torch.cat([light.new_zeros(1), light[1:]])


def _filled(albedo: Tensor, seen: Tensor, position_m: Tensor) -> Tensor:
    """What was hardly seen takes the color of what was, around it."""
    enough = (seen > SEEN_ENOUGH).numpy()
    if not enough.any():
        return albedo
    place = position_m.numpy()
    count = min(NEIGHBORS, int(enough.sum()))
    found: Any = KDTree(place[enough]).query(place, k=count)
    away, near = (array.reshape(len(place), count) for array in found)
    share = 1 / (away + 1e-4) ** 2
    around = np.einsum("nk,nkc->nc", share / share.sum(1, keepdims=True), albedo.numpy()[enough][near])
    return torch.where(torch.from_numpy(enough)[:, None], albedo, torch.from_numpy(around).to(albedo))
