"""Depth pictures with a known shape, for the tests of the shadow."""

import torch

from jghand_engine.render.camera import Camera


def camera(width: int, height: int, focal_px: float, *, fy: float | None = None, off_center: float = 0.0) -> Camera:
    eye = torch.eye(4, dtype=torch.float64)
    return Camera(width, height, focal_px, fy or focal_px, width / 2 + off_center, height / 2 - off_center, eye)


def rays(view: Camera) -> torch.Tensor:
    """Direction (H, W, 3) through every pixel center, with z = 1, float64."""
    y, x = torch.meshgrid(
        torch.arange(view.height, dtype=torch.float64) + 0.5,
        torch.arange(view.width, dtype=torch.float64) + 0.5,
        indexing="ij",
    )
    return torch.stack([(x - view.cx) / view.fx, (y - view.cy) / view.fy, torch.ones_like(x)], -1)


def plane(view: Camera, normal: tuple[float, float, float], distance_m: float) -> torch.Tensor:
    """Depth (H, W) of the plane through (0, 0, distance) with that normal."""
    n = torch.tensor(normal, dtype=torch.float64)
    return n[2] * distance_m / (rays(view) @ n)


def sphere(view: Camera, center_m: tuple[float, float, float], radius_m: float) -> torch.Tensor:
    """Depth (H, W) of the near side of a sphere, inf beside it."""
    direction, center = rays(view), torch.tensor(center_m, dtype=torch.float64)
    a, b = (direction * direction).sum(-1), direction @ center
    discriminant = b * b - a * (center @ center - radius_m**2)
    near = (b - discriminant.clamp_min(0).sqrt()) / a
    return torch.where(discriminant > 0, near, torch.inf)


def planes_of(depth_m: torch.Tensor, alpha: float = 0.9) -> torch.Tensor:
    """(5, H, W) float32 picture with that depth (inf = nothing there): a soft color, alpha, sum of weight * z."""
    there = torch.isfinite(depth_m)
    a = torch.where(there, alpha, 0.0)
    color = torch.tensor([0.8, 0.6, 0.5], dtype=torch.float64)[:, None, None] * a
    ramp = torch.linspace(0.5, 1, depth_m.shape[1], dtype=torch.float64)
    return torch.cat([color * ramp, a[None], (a * torch.where(there, depth_m, 0.0))[None]]).float()


def fingers(view: Camera, *, noise_m: float = 0.0, seed: int = 0) -> torch.Tensor:
    """A hand-like heap: a palm of one big sphere and rows of small ones over and beside it; depth (H, W)."""
    parts = [sphere(view, (0.0, 0.0, 0.62), 0.05)]
    for finger in range(4):
        for k in range(7):
            center = (-0.045 + 0.03 * finger, -0.08 + 0.021 * k, 0.575 + 0.004 * finger - 0.002 * k)
            parts.append(sphere(view, center, 0.012))
    depth = torch.stack(parts).amin(0)
    generator = torch.Generator().manual_seed(seed)
    return depth + noise_m * torch.randn(depth.shape, generator=generator, dtype=torch.float64)
