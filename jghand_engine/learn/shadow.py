"""Self-shadow of the hand from its own depth: normal-aware obscurance in torch, the specification of the native pass.

METHOD 5.2. For every pixel with a depth, N samples on a disc of world radius R are compared with the tangent plane;
what stands out of the plane within R occludes. A convex surface has nothing above its tangent plane, so it is not
darkened at any tilt. Only the premultiplied color of the hand is darkened, alpha stays.

Beyond METHOD 5.2: the depth of splats is bumpy, so normals span SHADOW_NORMAL_REACH_M instead of one pixel, and what
stands out by less than SHADOW_HEIGHT_MIN_M does not count. On smooth surfaces neither is worse, on splats both remove
specks.

Everything here is differentiable by autograd and runs in float64 or float32. `darken` takes the kernel where it can,
which differs by 5e-5 of visibility, except where the rounding of a sample position or the choice between two depth
differences falls the other way.
"""

from __future__ import annotations

import math

import numpy as np
import torch
from torch.nn.functional import softplus

from jghand_engine.native import contract
from jghand_engine.native.binding import Library
from jghand_engine.native.threads import shared_pool
from jghand_engine.render.camera import Camera
from jghand_engine.render.shadow import NativeShade, ShadowStyle, vogel_disc

# the paper's own form: where its offsets reach, pixels; about 20 mm at 0.9 m through the lens of our captures
PRINTED_RADIUS_PX = 24.0
# ... and beta of its curve, METHOD 5.2
PRINTED_BIAS = 0.1


def normalized_depth(depth_sum: torch.Tensor, alpha: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sum of weight * z and alpha, both (H, W) -> depth in meters (0 where there is none) and where there is one."""
    valid = alpha > contract.DEPTH_ALPHA_MIN
    depth_m = torch.where(valid, depth_sum / torch.where(valid, alpha, torch.ones_like(alpha)), 0.0)
    return depth_m, valid


def visibility(depth_m: torch.Tensor, valid: torch.Tensor, camera: Camera, style: ShadowStyle) -> torch.Tensor:
    """V (H, W) in (0, 1]: 1 = nothing above the tangent plane. Normals and sample positions carry no gradient.

    depth_m: (H, W) meters, any finite value where not `valid` · valid: (H, W) bool
    """
    if not bool(valid.any()):
        return torch.ones_like(depth_m)
    depth_m = torch.where(valid, depth_m, 1.0)  # an invalid pixel must not reach a division, even under a mask
    points = _unproject(depth_m, camera)
    normal = _normals(points.detach(), depth_m.detach(), valid, camera)[valid]
    flat, inside = _taps(depth_m.detach(), valid, camera, style)
    occluding = valid.reshape(-1)[flat] & inside
    v = points.reshape(-1, 3)[flat] - points[valid][:, None]
    length = torch.sqrt((v * v).sum(-1) + (contract.SHADOW_LENGTH_EPS * style.radius_m) ** 2)
    height_m = (v * normal[:, None]).sum(-1) - contract.SHADOW_HEIGHT_MIN_M
    cosine = height_m / length
    falloff = (1 - length / style.radius_m).clamp_min(0) ** 2
    occlusion = style.softness * softplus((cosine - style.bias) / style.softness) * falloff
    mean = torch.where(occluding, occlusion, torch.zeros_like(occlusion)).mean(-1)
    return torch.ones_like(depth_m).masked_scatter(valid, torch.exp(-style.gain * mean))


def printed_visibility(depth_sum: torch.Tensor, alpha: torch.Tensor, samples: int) -> torch.Tensor:
    """V = 1 - S (H, W) of the paper's S_x = 1/N sum_k f(d(x), d(x + dx_k)), with what it leaves open as METHOD 5.2 has
    it: d is the mean depth, f(a, b) = sigmoid(((a - b) / R - beta) / tau), the offsets lie on a disc of fixed size, and
    the background is far.

    depth_sum, alpha: (H, W) as of `normalized_depth` · samples: N
    """
    depth_m, valid = normalized_depth(depth_sum, alpha)
    offsets = torch.from_numpy((PRINTED_RADIUS_PX * vogel_disc(samples)).round()).long().flip(-1)
    taps = valid.nonzero()[:, None] + offsets
    size = torch.tensor(depth_m.shape)
    inside = ((taps >= 0) & (taps < size)).all(-1)
    row, column = torch.minimum(taps.clamp_min(0), size - 1).unbind(-1)
    nearer = (depth_m[valid][:, None] - depth_m[row, column]) / contract.SHADOW_RADIUS_M
    shade = torch.sigmoid((nearer - PRINTED_BIAS) / contract.SHADOW_SOFTNESS)
    mean = torch.where(inside & valid[row, column], shade, torch.zeros_like(shade)).mean(-1)
    return torch.ones_like(depth_m).masked_scatter(valid, 1 - mean)


def shade(
    rgb: torch.Tensor, alpha: torch.Tensor, depth_sum: torch.Tensor, camera: Camera, style: ShadowStyle
) -> torch.Tensor:
    """The premultiplied color (H, W, 3) of the hand, darkened: rgb * (1 - s k (1 - V)).

    rgb: (H, W, 3) premultiplied · alpha: (H, W) · depth_sum: (H, W) sum of weight * z, meters
    """
    depth_m, valid = normalized_depth(depth_sum, alpha)
    darkness = style.strength * (1 - visibility(depth_m, valid, camera, style))
    return rgb * (1 - darkness[..., None] * rgb.new_tensor(style.tint))


def surface_normals(depth_m: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Unit normals (H, W, 3) towards the camera, in its axes, of a depth map (H, W), meters, 0 where there is none;
    there they are 0. `render.passes` has the same in NumPy."""
    valid = depth_m > 0
    depth_m = torch.where(valid, depth_m, 1.0)
    normal = _normals(_unproject(depth_m, camera), depth_m, valid, camera)
    return torch.where(valid[..., None], normal, 0.0)


def _unproject(depth_m: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Points (H, W, 3) in the camera frame, meters."""
    height, width = depth_m.shape
    y = (torch.arange(height, dtype=depth_m.dtype) + 0.5 - camera.cy) / camera.fy
    x = (torch.arange(width, dtype=depth_m.dtype) + 0.5 - camera.cx) / camera.fx
    spread = _spread(depth_m, camera)
    return torch.stack([x[None, :] * spread, y[:, None] * spread, depth_m], -1)


def _spread(depth_m: torch.Tensor, camera: Camera) -> torch.Tensor:
    """How far apart rays are at a depth that are 1 apart at depth 1: that depth, or 1 where they are parallel."""
    return torch.ones_like(depth_m) if camera.orthographic else depth_m


def _taps(
    depth_m: torch.Tensor, valid: torch.Tensor, camera: Camera, style: ShadowStyle
) -> tuple[torch.Tensor, torch.Tensor]:
    """Flat index and inside-the-picture mask, both (P, N), of the samples of the P valid pixels."""
    height, width = depth_m.shape
    row, column = valid.nonzero().unbind(-1)
    disc = torch.from_numpy(vogel_disc(style.samples)).to(depth_m.dtype)
    reach = style.radius_m / _spread(depth_m, camera)[valid]
    lo, hi = contract.SHADOW_RADIUS_MIN_PX, contract.SHADOW_RADIUS_MAX_PX
    x = column[:, None] + ((camera.fx * reach).clamp(lo, hi)[:, None] * disc[:, 0]).round().long()
    y = row[:, None] + ((camera.fy * reach).clamp(lo, hi)[:, None] * disc[:, 1]).round().long()
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    return y.clamp(0, height - 1) * width + x.clamp(0, width - 1), inside


def _normals(points: torch.Tensor, depth_m: torch.Tensor, valid: torch.Tensor, camera: Camera) -> torch.Tensor:
    """Unit normals (H, W, 3) towards the camera, from the smaller one-sided depth difference along each axis.

    Differences span SHADOW_NORMAL_REACH_M, not one pixel as METHOD 5.2 has it: splats are bumpy.
    """
    tangents = []
    for axis, focal in ((0, camera.fy), (1, camera.fx)):
        step_px = (focal * contract.SHADOW_NORMAL_REACH_M / _spread(depth_m, camera)).clamp(
            contract.SHADOW_RADIUS_MIN_PX, contract.SHADOW_RADIUS_MAX_PX
        )
        tangents.append(_tangent(points, valid, step_px.round().long(), axis))
    normal = torch.linalg.cross(*tangents)
    square = (normal * normal).sum(-1, keepdim=True)
    normal = normal / torch.sqrt(square.clamp_min(contract.SHADOW_NORMAL_MIN2))
    away = normal[..., 2:] if camera.orthographic else (normal * points).sum(-1, keepdim=True)
    return torch.where(away > 0, -normal, normal)


def _tangent(points: torch.Tensor, valid: torch.Tensor, step: torch.Tensor, axis: int) -> torch.Tensor:
    """Difference of `points` over `step` (H, W) pixels along an image axis (0 rows, 1 columns).

    Beyond the picture there is no neighbor. A pixel without any gets the image axis, so that two such tangents give a
    normal that faces the camera.
    """
    (next_points, ahead), (last_points, behind) = (_neighbor(points, valid, sign * step, axis) for sign in (1, -1))
    forward, backward = next_points - points, points - last_points
    size_f, size_b = forward[..., 2].abs(), backward[..., 2].abs()
    floor = contract.SHADOW_AGREE * torch.minimum(size_f, size_b) + contract.SHADOW_AGREE_FLOOR_M
    agree = ahead & behind & ((size_f - size_b).abs() < floor)
    use_forward = ahead & (~behind | (size_f < size_b))
    fallback = torch.zeros_like(points)
    fallback[..., 1 - axis] = 1
    tangent = torch.where(use_forward[..., None], forward, backward)
    tangent = torch.where(agree[..., None], 0.5 * (forward + backward), tangent)
    return torch.where((ahead | behind)[..., None], tangent, fallback)


def _neighbor(
    points: torch.Tensor, valid: torch.Tensor, step: torch.Tensor, axis: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """`points` (H, W, 3) at index + step along an axis, and whether there is one."""
    size = points.shape[axis]
    index = torch.arange(size).reshape((-1, 1) if axis == 0 else (1, -1)) + step
    inside, index = (index >= 0) & (index < size), index.clamp(0, size - 1)
    there = torch.gather(valid, axis, index) & inside & valid
    return torch.gather(points, axis, index[..., None].expand(-1, -1, 3)), there


# ---- by the kernel ---------------------------------------------------------------------------------------------------


def mean_depth_m(planes: torch.Tensor) -> float:
    """The mean depth of planes (5, H, W), meters; 0 for an empty picture."""
    alpha, depth_sum = (float(plane.sum(dtype=torch.float64)) for plane in planes[3:])
    mean = depth_sum / alpha if alpha > 0 else 0.0
    return mean if math.isfinite(mean) else 0.0


class _NativeShading(torch.autograd.Function):
    """Planes (5, H, W) float32 -> darkened color (3, H, W)."""

    @staticmethod
    def forward(ctx, planes, library, camera, style, threads):
        height, width = planes.shape[1:]
        native = NativeShade(library, width, height)
        visibility = np.empty((height, width), np.float32)
        native.prepare(planes.numpy(), camera, style, near_m=mean_depth_m(planes), visibility=visibility)
        shared_pool(threads).run(native.run)
        ctx.native, ctx.visibility, ctx.threads = native, visibility, threads
        ctx.save_for_backward(planes)
        darkness = torch.tensor([style.strength * k for k in style.tint], dtype=torch.float32)
        return planes[:3] * (1 - darkness[:, None, None] * (1 - torch.from_numpy(visibility)))

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx, gradient):
        (planes,) = ctx.saved_tensors  # the kernel reads them again: torch checks that nobody changed them
        out = torch.empty_like(planes)
        task = ctx.native.prepare_backward(ctx.visibility, gradient.contiguous().numpy(), out.numpy())
        shared_pool(ctx.threads).run(lambda _thread: ctx.native.run_backward(task))
        return out, None, None, None, None


def darken(
    planes: torch.Tensor, camera: Camera, style: ShadowStyle, *, library: Library | None = None, threads: int = 0
) -> torch.Tensor:
    """The darkened premultiplied color (3, H, W) of planes (5, H, W): R G B, alpha, sum of weight * z. Differentiable.

    With a `library` and float32 planes by the compiled kernel, else by torch; so are gradients of parallel rays.
    """
    if library is None or planes.dtype != torch.float32 or camera.orthographic:
        return shade(planes[:3].permute(1, 2, 0), planes[3], planes[4], camera, style).permute(2, 0, 1)
    return _NativeShading.apply(planes.contiguous(), library, camera, style, threads)
