"""The pinhole camera of the rasterization contract.

OpenCV axes: x right, y down, z forward. Pixel (i, j) has its center at (i + 0.5, j + 0.5), (0, 0) is the top-left
pixel, and the principal point is in the same units. No lens distortion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch

from jghand_engine import limits
from jghand_engine.errors import InputError


@dataclass(frozen=True)
class Lens:
    """A thin lens. aperture_m: diameter of its opening, meters, 0 = a pinhole · focus_m: depth that is sharp, meters"""

    aperture_m: float
    focus_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.aperture_m) and self.aperture_m >= 0):
            raise InputError("lens: aperture_m", wanted="0 or a diameter in meters", came=str(self.aperture_m))
        if not (math.isfinite(self.focus_m) and self.focus_m > limits.Z_NEAR_M):
            wanted = f"a depth beyond the near plane, {limits.Z_NEAR_M:g} m"
            raise InputError("lens: focus_m", wanted=wanted, came=str(self.focus_m))

    def blur_px(self, focal_px: float, depth_m: float) -> float:
        """Diameter of the disc that a point at `depth_m` becomes, pixels."""
        return focal_px * self.aperture_m * abs(depth_m - self.focus_m) / (depth_m * self.focus_m)


@dataclass(frozen=True)
class Camera:
    """width, height: pixels; fx, fy, cx, cy: pixels; camera_from_world: (4, 4) float64 rigid map, meters; lens: None
    for a pinhole, through which everything is sharp (`rasterize` knows no other). orthographic: parallel rays, without
    a lens; fx and fy are pixels per meter then."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_world: torch.Tensor
    lens: Lens | None = None
    orthographic: bool = False

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError("camera size", wanted="at least 1 x 1 pixels", came=f"{self.width} x {self.height}")
        for name in ("fx", "fy"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InputError(f"camera {name}", wanted="a finite positive focal length in pixels", came=str(value))
        for name in ("cx", "cy"):
            if not math.isfinite(getattr(self, name)):
                raise InputError(
                    f"camera {name}", wanted="a finite principal point in pixels", came=str(getattr(self, name))
                )
        matrix = torch.as_tensor(self.camera_from_world, dtype=torch.float64)
        if matrix.shape != (4, 4) or not bool(torch.isfinite(matrix).all()):
            raise InputError("camera_from_world", wanted="a finite 4 x 4 matrix", came=f"shape {tuple(matrix.shape)}")
        if self.orthographic and self.lens is not None:
            raise InputError("orthographic camera", wanted="no lens", came=str(self.lens))
        object.__setattr__(self, "camera_from_world", matrix)

    @classmethod
    def looking_at(
        cls, eye_m: torch.Tensor, target_m: torch.Tensor, up: torch.Tensor, *, width: int, height: int, focal_px: float
    ) -> Camera:
        """A camera at `eye_m` (3,) that looks at `target_m` (3,) with `up` (3,) upwards in the picture; world meters.

        Square pixels and a centered principal point. A view without a direction, or along `up`, is an InputError.
        """
        eye, target, up = (torch.as_tensor(v, dtype=torch.float64) for v in (eye_m, target_m, up))
        forward = target - eye
        right = torch.linalg.cross(forward, up)
        if not (float(forward.norm()) > 0 and float(right.norm()) > 0):
            raise InputError(
                "camera direction", wanted="eye, target and up that span a plane", came="a degenerate view"
            )
        forward, right = forward / forward.norm(), right / right.norm()
        rotation = torch.stack([right, torch.linalg.cross(forward, right), forward])
        matrix = torch.eye(4, dtype=torch.float64)
        matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ eye
        return cls(width, height, focal_px, focal_px, width / 2, height / 2, matrix)

    @property
    def eye_m(self) -> torch.Tensor:
        """(3,) float64 where the camera stands, world meters. Of parallel rays: so far away that they might meet
        there."""
        rotation, offset_m = self.camera_from_world[:3, :3], self.camera_from_world[:3, 3]
        away_m = limits.PARALLEL_EYE_M if self.orthographic else 0.0
        return -(rotation.T @ offset_m) - away_m * rotation[2]

    def px_per_meter(self, depth_m: float) -> float:
        """How large a meter is on the picture at a depth, pixels, along the axis on which it is larger."""
        return max(self.fx, self.fy) / (1.0 if self.orthographic else depth_m)

    def scaled(self, factor: float) -> Camera:
        """The same view with `factor` times as many pixels along each side (rounded to whole pixels)."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def through(self, x_m: float, y_m: float) -> Camera:
        """The pinhole at a place of the lens, meters from its middle along the picture's axes. What is in focus stays
        where it was in the picture."""
        if self.lens is None:
            return self
        matrix = self.camera_from_world.clone()
        matrix[:2, 3] -= torch.tensor([x_m, y_m], dtype=torch.float64)
        cx, cy = (c + f * at / self.lens.focus_m for c, f, at in ((self.cx, self.fx, x_m), (self.cy, self.fy, y_m)))
        return replace(self, cx=cx, cy=cy, camera_from_world=matrix, lens=None)

    def part(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of a rectangle of the picture, pixels."""
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def project(self, points_m: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """World points (..., 3) in meters -> pixels (..., 2) and depth along the view axis (...) in meters."""
        matrix = self.camera_from_world.to(points_m.dtype)
        p = points_m @ matrix[:3, :3].T + matrix[:3, 3]
        depth = p[..., 2]
        scale = torch.ones_like(depth) if self.orthographic else depth
        u = self.fx * p[..., 0] / scale + self.cx
        v = self.fy * p[..., 1] / scale + self.cy
        return torch.stack([u, v], -1), depth
