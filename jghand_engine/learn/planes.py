"""Feature planes: learnable pictures that are looked up bilinearly, at points that never move or at joint angles.

Identity features of METHOD 4.1: three planes over (u, v), (u, d) and (v, d) of the canonical points. Because those
points are fixed, the four texels of each and their weights are too: a lookup is a gather of rows, four times as fast
as sampling a picture, forward and backward, and exactly as accurate.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn


class FixedLookup(nn.Module):
    """A learnable plane of `rows` x `columns` texels with `channels` features, looked up at fixed points.

    points: (N, 2) x along the columns, y along the rows, 0..1; the centers of the outer texels lie at 0 and 1.
    """

    def __init__(self, points: Tensor, rows: int, columns: int, channels: int) -> None:
        super().__init__()
        self.shape = (rows, columns, channels)
        self.texels = nn.Parameter(torch.zeros(rows * columns, channels))
        corner, weight = bilinear_corners(points, rows, columns)
        self.register_buffer("_corner", corner, persistent=False)
        self.register_buffer("_weight", weight, persistent=False)

    def forward(self, count: int) -> Tensor:
        """(count, channels) features of the first `count` points."""
        return weighted_rows(self.texels, self._corner[:, :count], self._weight[:, :count])  # type: ignore[index]

    def roughness(self) -> Tensor:
        """See `roughness`."""
        return roughness(self.texels.reshape(self.shape).movedim(-1, 0))


def roughness(planes: Tensor) -> Tensor:
    """Mean squared difference of neighboring texels of planes (..., rows, columns): the total variation that METHOD 4.2
    keeps small."""
    return planes.diff(dim=-2).square().mean() + planes.diff(dim=-1).square().mean()


def weighted_rows(table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
    """(N, C) the sum of K rows of a table (R, C) for each of N points, with a gradient for the table alone.

    index: (K, N) int64 · weight: (K, N) in the table's dtype
    """
    return _Gather.apply(table, index, weight)  # type: ignore[return-value]


class _Gather(torch.autograd.Function):
    """See weighted_rows."""

    @staticmethod
    def forward(ctx: Any, table: Tensor, index: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(index, weight)
        ctx.rows = table.shape[0]
        out = table[index[0]] * weight[0, :, None]
        for k in range(1, len(index)):
            out.addcmul_(table[index[k]], weight[k, :, None])
        return out

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, gradient: Tensor):  # type: ignore[override]
        index, weight = ctx.saved_tensors
        out = gradient.new_zeros(ctx.rows, gradient.shape[1])
        for k in range(len(index)):
            out.index_add_(0, index[k], gradient * weight[k, :, None])
        return out, None, None


def bilinear_corners(points: Tensor, rows: int, columns: int) -> tuple[Tensor, Tensor]:
    """Row-major indices (4, N) of the texels around points (N, 2) in 0..1, and their weights (4, N), which sum to 1."""
    x, y = (points.clamp(0, 1) * torch.tensor([columns - 1, rows - 1], dtype=points.dtype)).unbind(-1)
    left, top = x.floor().clamp(0, columns - 2), y.floor().clamp(0, rows - 2)
    right_part, low_part = x - left, y - top
    first = (top * columns + left).long()
    corner = torch.stack([first, first + 1, first + columns, first + columns + 1])
    weight = torch.stack(
        [
            (1 - right_part) * (1 - low_part), right_part * (1 - low_part),
            (1 - right_part) * low_part, right_part * low_part,
        ]
    )  # fmt: skip
    return corner, weight.float()


class IdentityPlanes(nn.Module):
    """Identity features (N, 64) of points with texture coordinates and depth uvd (N, 3) in 0..1 (METHOD 4.2)."""

    CHANNELS = (32, 16, 16)

    def __init__(self, uvd: Tensor, *, texels: int, depth_texels: int) -> None:
        super().__init__()
        u, v, d = uvd.unbind(-1)
        uv, ud, vd = self.CHANNELS
        self.uv = FixedLookup(torch.stack([u, v], -1), texels, texels, uv)
        self.ud = FixedLookup(torch.stack([u, d], -1), depth_texels, texels, ud)
        self.vd = FixedLookup(torch.stack([v, d], -1), depth_texels, texels, vd)

    @property
    def width(self) -> int:
        """Features per point."""
        return sum(self.CHANNELS)

    def forward(self, count: int) -> Tensor:
        """(count, 64) features of the first `count` points."""
        return torch.cat([plane(count) for plane in (self.uv, self.ud, self.vd)], -1)

    def roughness(self) -> Tensor:
        """Sum of the planes' roughness."""
        return torch.stack([plane.roughness() for plane in (self.uv, self.ud, self.vd)]).sum()
