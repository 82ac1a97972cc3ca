"""The differentiable terms of the training loss (METHOD 4.3), without their weights.

Pictures are (H, W, 3) display-referred sRGB 0..1 over black, alpha and mask (H, W) 0..1; every term is a scalar whose
gradient goes to what was predicted, never to the truth.
"""

from __future__ import annotations

import torch
from torch import Tensor

from jghand_engine.learn.ssim import ssim

# a learned offset counts as quadratic below this length, meters: at 0 a plain norm has no gradient, and offsets start
# there; a hundredth of a millimeter is nothing that could be seen
OFFSET_LENGTH_EPS_M = 1e-5


def l1_loss(rgb: Tensor, truth: Tensor) -> Tensor:
    """Mean |rgb - truth| over pixels and channels."""
    return (rgb - truth.detach()).abs().mean()


def ssim_loss(rgb: Tensor, truth: Tensor) -> Tensor:
    """1 - SSIM: 11 x 11 Gaussian window of sigma 1.5, windows wholly inside the picture."""
    return 1 - ssim(rgb, truth)


def mask_loss(alpha: Tensor, mask: Tensor) -> Tensor:
    """Mean (alpha - mask)^2 over the pixels."""
    return (alpha - mask.detach()).square().mean()


def offset_loss(*offsets_m: Tensor, hand_size_m: float) -> Tensor:
    """Sum over the given offsets of the mean length of their rows, as part of the hand's size.

    offsets_m: (N, 3) each, meters (offset of identity, offset of pose) · hand_size_m: canonical wrist to middle tip.
    Dividing makes meters and millimeters agree. The length is smooth, sqrt(|x|^2 + eps^2) - eps: offsets start at 0,
    where a plain norm has no gradient (METHOD 2.10).
    """
    eps = OFFSET_LENGTH_EPS_M
    squares = [(offset * offset).sum(-1) for offset in offsets_m]
    # the same as sqrt(square + eps^2) - eps, without its cancellation
    lengths = [(square / ((square + eps**2).sqrt() + eps)).mean() for square in squares]
    return torch.stack(lengths).sum() / hand_size_m


def tone_loss(shade: Tensor) -> Tensor:
    """Square of the mean shade of a pose (N, 3), summed over channels: what colors all skin alike is albedo, which is
    shown without shade too."""
    return shade.mean(0).square().sum()
