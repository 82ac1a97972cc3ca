"""What the rasterizer hands on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from jghand_engine import limits


@dataclass(frozen=True)
class Picture:
    """Color, coverage and depth of H x W pixels, row 0 at the top.

    rgb:        (H, W, 3) premultiplied by alpha, display-referred sRGB
    alpha:      (H, W)    0..1
    depth_sum:  (H, W)    sum of weight times camera depth, meters: `depth_m` is what most want
    visible_gaussians, invalid_gaussians: how many were drawn, and how many were left out as not drawable
    """

    rgb: torch.Tensor
    alpha: torch.Tensor
    depth_sum: torch.Tensor
    visible_gaussians: int = 0
    invalid_gaussians: int = 0

    @property
    def valid(self) -> torch.Tensor:
        """(H, W) bool: where there is enough coverage to speak of a depth."""
        return self.alpha > limits.DEPTH_ALPHA_MIN

    @property
    def depth_m(self) -> torch.Tensor:
        """(H, W) mean camera depth of what covers the pixel, meters; 0 where not `valid`.

        Zero is a mark, not a distance: whoever compares depths must look at `valid`.
        """
        zero = torch.zeros((), dtype=self.alpha.dtype, device=self.alpha.device)
        # the division must not see zero coverage, or its gradient is NaN even where the result is not used
        coverage = torch.where(self.valid, self.alpha, torch.ones_like(self.alpha))
        return torch.where(self.valid, self.depth_sum / coverage, zero)

    @classmethod
    def from_planes(cls, planes: torch.Tensor, *, visible_gaussians: int, invalid_gaussians: int) -> Picture:
        """From planes (5, H, W): premultiplied R G B, alpha, sum of weight times depth."""
        return cls(planes[:3].permute(1, 2, 0), planes[3], planes[4], visible_gaussians, invalid_gaussians)


def decibels(mean_square: float) -> float:
    """Peak signal to noise of values 0..1; capped at PSNR_MAX_DB, which equal pictures have."""
    if mean_square <= 10 ** (-limits.PSNR_MAX_DB / 10):
        return limits.PSNR_MAX_DB
    return -10 * math.log10(mean_square)
