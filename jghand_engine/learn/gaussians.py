"""Posed Gaussians, and the covariance of a canonical one after skinning (METHOD 2.8), differentiable."""

from __future__ import annotations

from dataclasses import dataclass

import torch

from jghand_engine.avatar.skin_task import QUATERNION_MIN
from jghand_engine.learn.rotations import dot, mat_mul, quaternion_rotation, safe_unit


@dataclass(frozen=True)
class Gaussians:
    """N Gaussians, ready to be drawn: spheres, or ellipsoids when there are covariances.

    position_m:    (N, 3) meters, in the frame the camera is given in (world)
    sigma_m:       (N,)   standard deviation, meters; with covariances a mean size for whoever wants one number: the
                          rasterizer then ignores it, for shape and culling alike, and gives it no gradient
    opacity:       (N,)   0..1
    rgb:           (N, 3) display-referred sRGB, blended as such
    covariance_m2: (N, 6) xx, xy, xz, yy, yz, zz in the same frame, square meters; None: sigma_m decides
    front:         (N,)   0..1 part of each that is seen from outside, in which a pixel's color is that of these parts
                          alone; below 0: it is not drawn; None: all of all
    pixel_m:       of the pictures that they were learned from, where the Gaussians are, meters: in finer ones the low
                   pass stays as wide there as in those (Yu et al., Mip-Splatting), without a gradient; 0: it is that
                   of the pixels
    """

    position_m: torch.Tensor
    sigma_m: torch.Tensor
    opacity: torch.Tensor
    rgb: torch.Tensor
    covariance_m2: torch.Tensor | None = None
    front: torch.Tensor | None = None
    pixel_m: float = 0.0

    def __len__(self) -> int:
        return self.position_m.shape[0]


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
        scale, turn = (tensor.to(dtype).movedim(0, -1).contiguous() for tensor in (log_scale.exp(), quaternion))
        none = turn.new_tensor([1.0, 0.0, 0.0, 0.0])[:, None]
        axes = mat_mul(maps, quaternion_rotation(safe_unit(turn, none, QUATERNION_MIN)[0]) * scale)
        return torch.stack([dot(axes[i], axes[j]) for i in range(3) for j in range(i, 3)], -1)
