"""Posed Gaussians: what an avatar hands to the renderer."""

from __future__ import annotations

from dataclasses import dataclass

import torch


@dataclass(frozen=True)
class Gaussians:
    """N isotropic Gaussians, ready to be drawn.

    position_m: (N, 3) metres, in the frame the camera is given in (world)
    sigma_m:    (N,)   standard deviation, metres
    opacity:    (N,)   0..1
    rgb:        (N, 3) display-referred sRGB, blended as such
    """

    position_m: torch.Tensor
    sigma_m: torch.Tensor
    opacity: torch.Tensor
    rgb: torch.Tensor

    def __len__(self) -> int:
        return self.position_m.shape[0]
