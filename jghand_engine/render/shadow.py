"""Self-shadow of the hand from its own depth: normal-aware obscurance in torch, the specification of the native pass.

METHOD 5.2. For every pixel with a depth, N samples on a disc of world radius R are compared with the tangent plane;
what stands out of the plane within R occludes. A convex surface has nothing above its tangent plane, so it is not
darkened at any tilt. Only the premultiplied color of the hand is darkened, alpha stays.

Beyond METHOD 5.2: the depth of splats is bumpy, so normals span SHADOW_NORMAL_REACH_M instead of one pixel, and what
stands out by less than SHADOW_HEIGHT_MIN_M does not count. On smooth surfaces neither is worse, on splats both remove
specks.

Everything here is differentiable by autograd and runs in float64 or float32; `splat/shadow_native.py` does the same
with compiled kernels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch.nn.functional import softplus

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.render.camera import Camera


@dataclass(frozen=True)
class ShadowStyle:
    """How the shadow looks.

    samples: taps per pixel · strength: 0..1 on top of everything (the gate's fade) · radius_m: reach R ·
    bias, softness: beta and tau of the occlusion curve · gain: darkness g · tint: strength k per color channel, 0..1
    """

    samples: int = 16
    strength: float = 1.0
    radius_m: float = limits.SHADOW_RADIUS_M
    bias: float = limits.SHADOW_BIAS
    softness: float = limits.SHADOW_SOFTNESS
    gain: float = limits.SHADOW_GAIN
    tint: tuple[float, float, float] = limits.SHADOW_TINT

    def __post_init__(self) -> None:
        checks = (
            ("samples", 1 <= self.samples <= limits.SHADOW_SAMPLES_MAX, f"1 to {limits.SHADOW_SAMPLES_MAX}"),
            ("strength", 0 <= self.strength <= 1, "0 to 1"),
            ("radius_m", math.isfinite(self.radius_m) and self.radius_m > 0, "a positive length in meters"),
            ("bias", math.isfinite(self.bias), "a finite number"),
            ("softness", math.isfinite(self.softness) and self.softness > 0, "a positive number"),
            ("gain", math.isfinite(self.gain) and self.gain >= 0, "0 or more"),
            ("tint", len(self.tint) == 3 and all(0 <= k <= 1 for k in self.tint), "three values from 0 to 1"),
        )
        for name, good, wanted in checks:
            if not good:
                raise InputError(f"shadow {name}", wanted=wanted, came=str(getattr(self, name)))
        if (1 + abs(self.bias)) / self.softness > limits.SHADOW_STEEPNESS_MAX:
            wanted = f"(1 + |bias|) / softness up to {limits.SHADOW_STEEPNESS_MAX:g}"
            raise InputError("shadow softness", wanted=wanted, came=f"{self.softness} with bias {self.bias}")


def vogel_disc(count: int) -> torch.Tensor:
    """`count` points of the unit disc at equal area, (count, 2) float64: a sunflower, the same for every pixel."""
    index = torch.arange(count, dtype=torch.float64) + 0.5
    radius, angle = torch.sqrt(index / count), index * limits.GOLDEN_ANGLE_RAD
    return torch.stack([radius * torch.cos(angle), radius * torch.sin(angle)], -1)


def normalized_depth(depth_sum: torch.Tensor, alpha: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Sum of weight * z and alpha, both (H, W) -> depth in meters (0 where there is none) and where there is one."""
    valid = alpha > limits.DEPTH_ALPHA_MIN
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
    length = torch.sqrt((v * v).sum(-1) + (limits.SHADOW_LENGTH_EPS * style.radius_m) ** 2)
    height_m = (v * normal[:, None]).sum(-1) - limits.SHADOW_HEIGHT_MIN_M
    cosine = height_m / length
    falloff = (1 - length / style.radius_m).clamp_min(0) ** 2
    occlusion = style.softness * softplus((cosine - style.bias) / style.softness) * falloff
    mean = torch.where(occluding, occlusion, torch.zeros_like(occlusion)).mean(-1)
    return torch.ones_like(depth_m).masked_scatter(valid, torch.exp(-style.gain * mean))


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
    there they are 0."""
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
    disc = vogel_disc(style.samples).to(depth_m.dtype)
    reach = style.radius_m / _spread(depth_m, camera)[valid]
    lo, hi = limits.SHADOW_RADIUS_MIN_PX, limits.SHADOW_RADIUS_MAX_PX
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
        step_px = (focal * limits.SHADOW_NORMAL_REACH_M / _spread(depth_m, camera)).clamp(
            limits.SHADOW_RADIUS_MIN_PX, limits.SHADOW_RADIUS_MAX_PX
        )
        tangents.append(_tangent(points, valid, step_px.round().long(), axis))
    normal = torch.linalg.cross(*tangents)
    square = (normal * normal).sum(-1, keepdim=True)
    normal = normal / torch.sqrt(square.clamp_min(limits.SHADOW_NORMAL_MIN2))
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
    floor = limits.SHADOW_AGREE * torch.minimum(size_f, size_b) + limits.SHADOW_AGREE_FLOOR_M
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
