"""Ellipsoids on a moving hand: the covariance of a canonical Gaussian after skinning (METHOD 2.8), differentiable."""

from __future__ import annotations

import torch

from jghand_engine.avatar.skin_task import QUATERNION_MIN
from jghand_engine.learn.rotations import dot, mat_mul, quaternion_rotation, safe_unit


def posed_covariance(log_scale: torch.Tensor, quaternion: torch.Tensor, linear: torch.Tensor) -> torch.Tensor:
    """(N, 6) xx, xy, xz, yy, yz, zz, square meters: L S L^T with S = R diag(scale^2) R^T, for `Gaussians`.

    log_scale:  (N, 3) natural logarithms of standard deviations, meters, along a Gaussian's own axes
    quaternion: (N, 4) wxyz, turns these axes into the canonical hand's; of any length, and no rotation at length 0.
                The gradient (never the value) is damped below the length GRADIENT_DAMPING, and 0 at 0.
    linear:     (N, 3, 3) blended linear maps of `skinning.blend`, mirrored and collapsed ones too; its dtype is that of
                the result

    As (L R scale)(L R scale)^T, by multiply-add without GEMM: the diagonal is a sum of squares, never negative.
    """
    with torch.autocast(linear.device.type, enabled=False):
        dtype = linear.dtype
        maps = linear.movedim(0, -1).contiguous()
        axes = mat_mul(maps, canonical_axes(log_scale.to(dtype), quaternion.to(dtype)))
        return torch.stack([dot(axes[i], axes[j]) for i in range(3) for j in range(i, 3)], -1)


def canonical_axes(log_scale: torch.Tensor, quaternion: torch.Tensor) -> torch.Tensor:
    """(3, 3, N) R diag(scale): the axes of ellipsoids as columns, meters; arguments as above, of one dtype.

    Components first: long contiguous rows (learn/rotations.py).
    """
    scale, turn = (tensor.movedim(0, -1).contiguous() for tensor in (torch.exp(log_scale), quaternion))
    none = turn.new_tensor([1.0, 0.0, 0.0, 0.0])[:, None]
    return quaternion_rotation(safe_unit(turn, none, QUATERNION_MIN)[0]) * scale
