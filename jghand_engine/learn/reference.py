"""The rasterization contract (RENDERING 3) in executable form: pure torch, any float dtype and device, differentiable.

Everything else is tested against this in float64. It never stops early; memory stays bounded because tiles are drawn
one after the other and recomputed in the backward pass.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
from torch.utils.checkpoint import checkpoint

from jghand_engine.errors import InputError
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.light import smooth as smoothstep
from jghand_engine.native import contract
from jghand_engine.native.rasterizer import SURFACE_MARGIN_PX, SeenSurface
from jghand_engine.render.camera import Camera

# as kernels store it
NOT_NEAR = float(np.float32(contract.NOT_NEAR))
# pairs of pixel and Gaussian that are held at once: some 30 MB per intermediate in float64
REFERENCE_PAIRS_AT_ONCE = 4_000_000


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
        return self.alpha > contract.DEPTH_ALPHA_MIN

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


@dataclass(frozen=True)
class _Ellipses:
    """M projected Gaussians. u, v: center, px; a, b, c: covariance, px^2, and its determinant; z: camera depth, m."""

    u: torch.Tensor
    v: torch.Tensor
    a: torch.Tensor
    b: torch.Tensor
    c: torch.Tensor
    det: torch.Tensor
    z: torch.Tensor
    opacity: torch.Tensor
    features: torch.Tensor  # (M, 5): rgb, 1, z: what the weights are summed with

    def select(self, index: torch.Tensor) -> _Ellipses:
        return _Ellipses(*(getattr(self, name)[index] for name in self.__dataclass_fields__))


def rasterize_reference(
    gaussians: Gaussians,
    camera: Camera,
    *,
    alpha_min: float = contract.ALPHA_MIN,
    smooth: bool = False,
    surface: SeenSurface | None = None,
) -> Picture:
    """Draws `gaussians` as `camera` sees them.

    alpha_min: contributions below it are zero, by a hard step as the contract says, or with `smooth` by a C1 step over
    [alpha_min, 2 alpha_min], which only finite-difference tests want. surface: of the image, where Gaussians with a
    `front` that are not its own count less.
    InputError names a tensor of a wrong shape or dtype. Values that cannot be drawn are left out and counted.
    """
    check_gaussians(gaussians)
    position_c = camera_frame(gaussians.position_m, camera)
    # selected by index before anything is differentiated: what is left out never enters the arithmetic, so that its
    # infinities and NaN reach no gradient (zero times infinity is NaN)
    with torch.no_grad():
        kept, invalid = _select(gaussians, position_c, camera, alpha_min)
    ellipses = _project(gaussians, position_c, kept, camera)
    own = None if surface is None or gaussians.front is None else _Own(own_depths(surface, camera), surface.part)
    draw = partial(
        _draw_tiles, camera=camera, alpha_min=alpha_min, smooth=smooth, fills=gaussians.front is not None, own=own
    )
    picture = Picture.from_planes(draw(ellipses), visible_gaussians=len(kept), invalid_gaussians=invalid)
    if gaussians.front is None:
        return picture
    parts = gaussians.front[kept, None].expand(-1, 3)
    front = draw(replace(ellipses, features=torch.cat([parts, ellipses.features[:, 3:]], 1)))[0, ..., None]
    alpha, tiny = picture.alpha, torch.finfo(picture.alpha.dtype).tiny
    cover = smoothstep((alpha - contract.COVER_FROM) / (contract.COVER_WHOLE - contract.COVER_FROM))
    gain = cover[..., None] / torch.maximum(front, (contract.FRONT_MIN * alpha[..., None]).clamp_min(tiny))
    depth_sum = picture.depth_sum * cover / alpha.clamp_min(tiny)
    return replace(picture, rgb=picture.rgb * gain, alpha=cover, depth_sum=depth_sum)


@dataclass(frozen=True)
class _Own:
    """depths: (H, W, 2) from which to which Gaussians are a pixel's own, m, or (P, 2) · part: how much that counts"""

    depths: torch.Tensor
    part: float


def own_depths(surface: SeenSurface, camera: Camera) -> torch.Tensor:
    """(H, W, 2) float64, meters: from which depth to which a Gaussian is of the skin that a pixel shows. From a little
    before to a little behind it, and the width of a pixel farther; more where it is steep; all, where there is none."""
    margin, near = SURFACE_MARGIN_PX, torch.from_numpy(surface.near).to(torch.float64)

    def depth(down: int, right: int) -> torch.Tensor:
        rows, columns = (
            slice(margin + down, margin + down + camera.height),
            slice(margin + right, margin + right + camera.width),
        )
        here = near[rows, columns]
        return torch.where(here > NOT_NEAR, -here if camera.orthographic else 1 / here, math.nan)

    middle, steep2 = depth(0, 0), 1.0
    beside = [[depth(0, side) for side in (-1, 1)], [depth(side, 0) for side in (-1, 1)]]
    for axis, focal in zip(beside, (camera.fx, camera.fy), strict=True):
        change = torch.stack([(each - middle).abs().nan_to_num(nan=math.inf) for each in axis]).amin(0)
        steep2 = steep2 + (change * (focal if camera.orthographic else focal / middle)) ** 2
    steep = torch.as_tensor(steep2).sqrt().clamp(max=contract.OWN_STEEPEST)
    pixel_m = (torch.ones_like(middle) if camera.orthographic else middle) / camera.fx
    before_m, behind_m = (length * surface.scale + pixel_m for length in (contract.OWN_BEFORE_M, contract.OWN_BEHIND_M))
    least, most = middle - before_m * steep, middle + behind_m * steep
    return torch.stack([least.nan_to_num(nan=-math.inf), most.nan_to_num(nan=math.inf)], -1)


def check_gaussians(gaussians: Gaussians) -> None:
    """InputError that names the tensor, unless shapes are (N, 3), (N,), (N,), (N, 3) and, where there are covariances,
    (N, 6), of one float dtype and device.

    Nothing is broadcast: a (N, 1) opacity would draw something, and not what was meant.
    Values are not checked: what cannot be drawn is left out and counted (RENDERING 3).
    """
    tensors = {name: getattr(gaussians, name) for name in ("position_m", "sigma_m", "opacity", "rgb")}
    if gaussians.covariance_m2 is not None:
        tensors["covariance_m2"] = gaussians.covariance_m2
    for name, tensor in tensors.items():
        if not isinstance(tensor, torch.Tensor):
            raise InputError(f"Gaussians, {name}", wanted="a torch tensor", came=type(tensor).__name__)
    position = gaussians.position_m
    n = position.shape[0] if position.ndim else 0
    shapes = {"position_m": (n, 3), "sigma_m": (n,), "opacity": (n,), "rgb": (n, 3), "covariance_m2": (n, 6)}
    for name, tensor in tensors.items():
        if tuple(tensor.shape) != shapes[name]:
            wanted = f"shape {shapes[name]}" if name != "position_m" else "shape (N, 3)"
            raise InputError(f"Gaussians, {name}", wanted=wanted, came=f"shape {tuple(tensor.shape)}")
        if tensor.dtype not in (torch.float32, torch.float64):
            raise InputError(f"Gaussians, {name}", wanted="dtype float32 or float64", came=str(tensor.dtype))
        if tensor.dtype != position.dtype or tensor.device != position.device:
            wanted = f"{position.dtype} on {position.device} like position_m"
            raise InputError(f"Gaussians, {name}", wanted=wanted, came=f"{tensor.dtype} on {tensor.device}")


def camera_frame(position_m: torch.Tensor, camera: Camera) -> torch.Tensor:
    """World positions (N, 3) to the camera frame, same dtype; in float64 on the way, so that distance costs nothing."""
    matrix = torch.from_numpy(camera.camera_from_world).to(position_m.device)
    return (position_m.to(torch.float64) @ matrix[:3, :3].T + matrix[:3, 3]).to(position_m.dtype)


def _select(
    gaussians: Gaussians, position_c: torch.Tensor, camera: Camera, alpha_min: float
) -> tuple[torch.Tensor, int]:
    """Indices of the visible Gaussians front to back, ties by index, and the number of invalid ones."""
    valid = _valid(gaussians)
    in_front = torch.nonzero(valid & (position_c[:, 2] > contract.Z_NEAR_M))[:, 0]
    ellipses = _project(gaussians, position_c, in_front, camera)
    sized = (ellipses.a < contract.VAR_MAX_PX2) & (ellipses.c < contract.VAR_MAX_PX2)
    invalid = int((~valid).sum()) + int((~sized).sum())
    left, right, top, bottom = _boxes(ellipses, alpha_min)
    on_picture = (right > 0) & (left < camera.width) & (bottom > 0) & (top < camera.height)
    drawn = sized & on_picture & (ellipses.opacity > alpha_min)
    if gaussians.front is not None:
        drawn &= gaussians.front[in_front] >= 0
    visible = torch.nonzero(drawn)[:, 0]
    # the contract's key is the depth in float32, in every precision
    front_to_back = torch.argsort(ellipses.z[visible].to(torch.float32), stable=True)
    return in_front[visible[front_to_back]], invalid


def _valid(gaussians: Gaussians) -> torch.Tensor:
    """(N,) bool: every value can be drawn. Comparisons with NaN are false."""
    g, reach = gaussians, contract.POSITION_MAX_M
    covariance = g.covariance_m2
    shapes = (g.sigma_m > 0) & (g.sigma_m < math.inf) if covariance is None else semi_definite(covariance)
    return (
        (g.position_m.abs() <= reach).all(1)
        & shapes
        & (g.opacity >= 0)
        & (g.opacity <= 1)
        & (g.rgb.abs() <= contract.RGB_MAX).all(1)
    )


def semi_definite(covariance_m2: torch.Tensor) -> torch.Tensor:
    """(N,) bool: which of (N, 6) covariances are finite, not zero, and positive semi-definite up to rounding.

    With a little of the trace added to the diagonal, all leading minors are positive (Sylvester's criterion). The trace
    is then positive too.
    """
    xx, xy, xz, yy, yz, zz = covariance_m2.to(torch.float64).unbind(1)
    trace = xx + yy + zz
    slack = contract.COVARIANCE_SLACK * trace
    xx, yy, zz = xx + slack, yy + slack, zz + slack
    two = xx * yy - xy * xy
    three = xx * (yy * zz - yz * yz) - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz)
    return (trace < math.inf) & (xx > 0) & (two > 0) & (three > 0)


def _project(gaussians: Gaussians, position_c: torch.Tensor, kept: torch.Tensor, camera: Camera) -> _Ellipses:
    """Projection of the centers and of the shapes."""
    x, y, z = position_c[kept].unbind(1)
    opacity, rgb, covariance = gaussians.opacity[kept], gaussians.rgb[kept], gaussians.covariance_m2
    scale = torch.ones_like(z) if camera.orthographic else z
    jx, jy = camera.fx / scale, camera.fy / scale
    u, v = jx * x, jy * y
    flat = torch.zeros_like(z)
    jacobian = (jx, jy, flat, flat) if camera.orthographic else (jx, jy, -u / z, -v / z)
    blur = ((jx * jy).detach() * (contract.BLUR_PX2 * gaussians.pixel_m**2)).clamp_min(contract.BLUR_PX2)
    if covariance is None:
        shapes = _project_spheres(gaussians.sigma_m[kept], jacobian, blur)
    else:
        shapes = _project_ellipsoids(covariance[kept], jacobian, blur, camera)
    features = torch.cat([rgb, torch.ones_like(z)[:, None], z[:, None]], 1)
    return _Ellipses(u + camera.cx, v + camera.cy, *shapes, z, opacity, features)


_Four = tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]


def _project_spheres(sigma: torch.Tensor, jacobian: _Four, blur: torch.Tensor) -> _Four:
    """a, b, c and determinant, with the low pass added, from radii (M,) and du/dx, dv/dy, du/dz, dv/dz (M,)."""
    jx, jy, jxz, jyz = jacobian
    xx, xz, yy, yz = (sigma * jx) ** 2, (sigma * jxz) ** 2, (sigma * jy) ** 2, (sigma * jyz) ** 2
    a, b, c = xx + xz + blur, (sigma * jxz) * (sigma * jyz), yy + yz + blur
    # a c - b^2 multiplied out: only positive terms remain, nothing cancels for long thin ellipses
    return a, b, c, xx * yy + xx * yz + xz * yy + blur * (xx + xz + yy + yz) + blur**2


def _project_ellipsoids(covariance: torch.Tensor, jacobian: _Four, blur: torch.Tensor, camera: Camera) -> _Four:
    """The same from covariances S (M, 6) of the world: J R S R^T J^T + blur (EWA).

    In float64 on the way, for a c - b^2 cancels for long thin ellipses and cannot be multiplied out here.
    """
    rotation = torch.from_numpy(camera.camera_from_world[:3, :3]).to(covariance.device)
    jx, jy, jxz, jyz = (j.to(torch.float64)[:, None] for j in jacobian)
    tu, tv = jx * rotation[0] + jxz * rotation[2], jy * rotation[1] + jyz * rotation[2]
    matrix = covariance.to(torch.float64)[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].unflatten(1, (3, 3))
    mu, mv = (matrix * tu[:, None]).sum(2), (matrix * tv[:, None]).sum(2)
    a, b, c = (tu * mu).sum(1), (tu * mv).sum(1), (tv * mv).sum(1)
    # flat Gaussians may be a rounding error beyond flat: the nearest ellipse that exists, with the gradient of others
    a, c = _set(a, a.detach().clamp_min(0)), _set(c, c.detach().clamp_min(0))
    flat = a * c - b * b
    det = _set(flat, flat.detach().clamp_min(0)) + blur * (a + c) + blur**2
    longest = torch.sqrt((a * c).detach())
    b = _set(b, b.detach().clamp(-longest, longest))
    dtype = covariance.dtype
    return (a + blur).to(dtype), b.to(dtype), (c + blur).to(dtype), det.to(dtype)


def _set(tensor: torch.Tensor, value: torch.Tensor) -> torch.Tensor:
    """`value`, with the gradient of `tensor`."""
    return value + (tensor - tensor.detach())


def _boxes(ellipses: _Ellipses, alpha_min: float) -> torch.Tensor:
    """Left, right, top, bottom (4, M), px, of the ellipse on which alpha falls to alpha_min."""
    e = ellipses
    # an opacity at or below the cut has no such ellipse: it is clamped before the root of a negative number is drawn
    k = 2 * torch.log(e.opacity.clamp_min(alpha_min) / alpha_min)
    rx, ry = torch.sqrt(k * e.a), torch.sqrt(k * e.c)
    return torch.stack([e.u - rx, e.u + rx, e.v - ry, e.v + ry])


def _draw_tiles(
    ellipses: _Ellipses, camera: Camera, *, alpha_min: float, smooth: bool, fills: bool, own: _Own | None
) -> torch.Tensor:
    """Planes (5, H, W), tile by tile. fills, own: see `_blend`"""
    with torch.no_grad():
        left, right, top, bottom = _boxes(ellipses, alpha_min)
    tile, rows = contract.TILE_PX, []
    for y in range(0, camera.height, tile):
        height = min(tile, camera.height - y)
        in_row = torch.nonzero((bottom > y) & (top < y + tile))[:, 0]
        row_left, row_right = left[in_row], right[in_row]
        columns = []
        for x in range(0, camera.width, tile):
            width = min(tile, camera.width - x)
            index = in_row[(row_right > x) & (row_left < x + tile)]
            pixels = _pixel_centers(x, y, width, height, ellipses.u)
            here = own and replace(own, depths=own.depths[y : y + height, x : x + width].reshape(-1, 2))
            values = _draw_pixels(
                ellipses.select(index), pixels, alpha_min=alpha_min, smooth=smooth, fills=fills, own=here
            )
            columns.append(values.reshape(height, width, 5))
        rows.append(torch.cat(columns, 1))
    return torch.cat(rows, 0).permute(2, 0, 1)


def _pixel_centers(x: int, y: int, width: int, height: int, like: torch.Tensor) -> torch.Tensor:
    """(height * width, 2) px, row by row."""
    xs = torch.arange(x, x + width, dtype=like.dtype, device=like.device) + 0.5
    ys = torch.arange(y, y + height, dtype=like.dtype, device=like.device) + 0.5
    return torch.cartesian_prod(ys, xs).reshape(-1, 2).flip(1)


def _draw_pixels(
    ellipses: _Ellipses, pixels: torch.Tensor, *, alpha_min: float, smooth: bool, fills: bool, own: _Own | None
) -> torch.Tensor:
    """(P, 5): R G B A D of P pixels, as many at a time as fit into the memory allowed. fills, own: see `_blend`"""
    count = ellipses.u.shape[0]
    if count == 0:
        return ellipses.features.sum(0).expand(pixels.shape[0], 5)  # zeros that belong to the graph
    at_once = max(1, REFERENCE_PAIRS_AT_ONCE // count)
    tensors = [getattr(ellipses, name) for name in ellipses.__dataclass_fields__]

    def blend(some: torch.Tensor, *fields: torch.Tensor) -> torch.Tensor:
        here = own and replace(own, depths=some[:, 2:])
        return _blend(_Ellipses(*fields), some[:, :2], alpha_min=alpha_min, smooth=smooth, fills=fills, own=here)

    if own:
        pixels = torch.cat([pixels, own.depths.to(pixels)], 1)

    parts = []
    for some in pixels.split(at_once):
        if torch.is_grad_enabled() and any(tensor.requires_grad for tensor in tensors):
            parts.append(checkpoint(blend, some, *tensors, use_reentrant=False, preserve_rng_state=False))
        else:
            parts.append(blend(some, *tensors))
    return torch.cat(parts)


def _blend(
    ellipses: _Ellipses, pixels: torch.Tensor, *, alpha_min: float, smooth: bool, fills: bool, own: _Own | None
) -> torch.Tensor:
    """(P, 5) sums of weight times features, front to back; column 3 is 1 - transmittance. fills: what stands beneath
    gives a part of its color alone, and at last nothing, as the contract has it for Gaussians with `front` · own: of
    the pixels, the rest counts less"""
    e = ellipses
    dx, dy = pixels[:, :1] - e.u, pixels[:, 1:] - e.v
    q = 0.5 * (e.c * dx * dx - 2 * e.b * dx * dy + e.a * dy * dy) / e.det
    alpha = _cut(e.opacity * torch.exp(-q), alpha_min, smooth=smooth)
    # `where` and not `clamp`: at the cap the gradient is zero
    alpha = torch.where(alpha < contract.ALPHA_MAX, alpha, torch.full_like(alpha, contract.ALPHA_MAX))
    if own:
        is_own = (e.z > own.depths[:, :1]) & (e.z < own.depths[:, 1:])
        alpha = torch.where(is_own, alpha, alpha * (1 - own.part * (1 - contract.OTHERS_PART)))
    behind = torch.cumprod(1 - alpha, 1)
    transmittance = torch.cat([torch.ones_like(behind[:, :1]), behind[:, :-1]], 1)
    weight = alpha * transmittance
    if not fills:
        return weight @ e.features
    span = contract.BENEATH_WHOLE - contract.BENEATH_FROM
    shown = weight * ((transmittance - contract.BENEATH_FROM) / span).clamp(0, 1)
    least = contract.BENEATH_FROM
    counted = transmittance.clamp_min(least) - behind.clamp_min(least)
    return torch.cat([shown @ e.features[:, :3], counted @ e.features[:, 3:]], 1)


def _cut(alpha: torch.Tensor, alpha_min: float, *, smooth: bool) -> torch.Tensor:
    if smooth:
        t = ((alpha - alpha_min) / alpha_min).clamp(0, 1)
        return alpha * t * t * (3 - 2 * t)
    return torch.where(alpha < alpha_min, torch.zeros_like(alpha), alpha)
