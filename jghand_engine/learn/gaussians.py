"""Posed Gaussians: what an avatar hands to the renderer."""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians, ready to be drawn: spheres, or ellipsoids when there are covariances.

    position_m:    (N, 3) meters, in the frame the camera is given in (world)
    sigma_m:       (N,)   standard deviation, meters; with covariances a mean size for whoever wants one number: the
                          rasterizer then ignores it, for shape and culling alike, and gives it no gradient
    opacity:       (N,)   0..1
    rgb:           (N, 3) display-referred sRGB, blended as such
    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz in the same frame, square meters; None: sigma_m decides
    """

    position_m: torch.Tensor
    sigma_m: torch.Tensor
    opacity: torch.Tensor
    rgb: torch.Tensor
    covariance_m2: torch.Tensor | None = None

    def __len__(self) -> int:
        return self.position_m.shape[0]
