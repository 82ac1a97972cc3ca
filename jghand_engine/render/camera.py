"""The pinhole camera of the rasterization contract.

OpenCV axes: x right, y down, z forward. Pixel (i, j) has its center at (i + 0.5, j + 0.5), (0, 0) is the top-left
pixel, and the principal point is in the same units. No lens distortion.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from jghand_engine.errors import InputError
from jghand_engine.native import contract

# meters at which parallel rays are taken to meet: their directions differ by 1e-7 over a hand then, float32's rounding
PARALLEL_EYE_M = 1e6


@dataclass(frozen=True)
class Lens:
    """A thin lens.

    aperture_m: diameter of its opening, meters, 0 = a pinhole
    focus_m:    depth that is sharp, meters
    """

    aperture_m: float
    focus_m: float

    def __post_init__(self) -> None:
        if not (math.isfinite(self.aperture_m) and self.aperture_m >= 0):
            raise InputError("lens: aperture_m", wanted="0 or a diameter in meters", came=str(self.aperture_m))
        if not (math.isfinite(self.focus_m) and self.focus_m > contract.Z_NEAR_M):
            wanted = f"a depth beyond the near plane, {contract.Z_NEAR_M:g} m"
            raise InputError("lens: focus_m", wanted=wanted, came=str(self.focus_m))

    def blur_px(self, focal_px: float, depth_m: float) -> float:
        """Diameter of the disc that a point at `depth_m` becomes, pixels."""
        return focal_px * self.aperture_m * abs(depth_m - self.focus_m) / (depth_m * self.focus_m)


@dataclass(frozen=True)
class Camera:
    """A pinhole camera, one with a thin lens, or one of parallel rays.

    width, height:     of the image, pixels
    fx, fy:            focal lengths, pixels; of parallel rays pixels per meter
    cx, cy:            principal point, pixels
    camera_from_world: (4, 4) float64 rigid map, meters
    lens:              None for a pinhole, through which everything is sharp; the rasterizer knows no other
    orthographic:      parallel rays, without a lens
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_world: np.ndarray
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
        matrix = np.asarray(self.camera_from_world, np.float64).copy()
        if matrix.shape != (4, 4) or not np.isfinite(matrix).all():
            raise InputError("camera_from_world", wanted="a finite 4 x 4 matrix", came=f"shape {matrix.shape}")
        if self.orthographic and self.lens is not None:
            raise InputError("orthographic camera", wanted="no lens", came=str(self.lens))
        object.__setattr__(self, "camera_from_world", matrix)

    @classmethod
    def looking_at(
        cls, eye_m: ArrayLike, target_m: ArrayLike, up: ArrayLike, *, width: int, height: int, focal_px: float
    ) -> Camera:
        """A camera at `eye_m` (3,) that looks at `target_m` (3,) with `up` (3,) upwards in the image; world meters.

        Square pixels and a centered principal point. A view without a direction, or along `up`, is an InputError.
        """
        eye, target, upward = (np.asarray(v, np.float64) for v in (eye_m, target_m, up))
        forward = target - eye
        right = np.cross(forward, upward)
        if not (np.linalg.norm(forward) > 0 and np.linalg.norm(right) > 0):
            raise InputError(
                "camera direction", wanted="eye, target and up that span a plane", came="a degenerate view"
            )
        forward, right = forward / np.linalg.norm(forward), right / np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = rotation, -rotation @ eye
        return cls(width, height, focal_px, focal_px, width / 2, height / 2, matrix)

    @property
    def eye_m(self) -> np.ndarray:
        """(3,) float64 where the camera stands, world meters. Of parallel rays: so far away that they might meet
        there."""
        rotation, offset_m = self.camera_from_world[:3, :3], self.camera_from_world[:3, 3]
        away_m = PARALLEL_EYE_M if self.orthographic else 0.0
        return -(rotation.T @ offset_m) - away_m * rotation[2]

    @property
    def pinhole(self) -> Camera:
        """It without its lens."""
        return self if self.lens is None else replace(self, lens=None)

    def about(self, origin_m: np.ndarray) -> Camera:
        """It for positions relative to an origin (3,), world meters."""
        matrix = self.camera_from_world.copy()
        matrix[:3, 3] += matrix[:3, :3] @ origin_m
        return replace(self, camera_from_world=matrix)

    def px_per_meter(self, depth_m: float) -> float:
        """How large a meter is on the image at a depth, pixels, along the axis on which it is larger."""
        return max(self.fx, self.fy) / (1.0 if self.orthographic else depth_m)

    def scaled(self, factor: float) -> Camera:
        """The same view with `factor` times as many pixels along each side (rounded to whole pixels)."""
        width, height = max(1, round(self.width * factor)), max(1, round(self.height * factor))
        sx, sy = width / self.width, height / self.height
        return replace(
            self, width=width, height=height, fx=self.fx * sx, fy=self.fy * sy, cx=self.cx * sx, cy=self.cy * sy
        )

    def through(self, x_m: float, y_m: float) -> Camera:
        """The pinhole at a place of the lens, meters from its middle along the image's axes. What is in focus stays
        where it was in the image."""
        if self.lens is None:
            return self
        matrix = self.camera_from_world.copy()
        matrix[:2, 3] -= (x_m, y_m)
        cx, cy = (c + f * at / self.lens.focus_m for c, f, at in ((self.cx, self.fx, x_m), (self.cy, self.fy, y_m)))
        return replace(self, cx=cx, cy=cy, camera_from_world=matrix, lens=None)

    def part(self, left: int, top: int, width: int, height: int) -> Camera:
        """The camera of a rectangle of the image, pixels."""
        if (left, top, width, height) == (0, 0, self.width, self.height):
            return self
        return replace(self, width=width, height=height, cx=self.cx - left, cy=self.cy - top)

    def project(self, points_m: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """World points (..., 3) in meters -> float64 pixels (..., 2) and depth along the view axis (...) in meters."""
        matrix = self.camera_from_world
        p = np.asarray(points_m, np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
        depth = p[..., 2]
        slope = p[..., :2] if self.orthographic else _divided(p[..., :2], depth[..., None])
        return slope * (self.fx, self.fy) + (self.cx, self.cy), depth


def _divided(numerator: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Their quotient; infinite or NaN without a warning for a point in the plane of the camera."""
    if depth.all():
        return numerator / depth
    with np.errstate(divide="ignore", invalid="ignore"):
        return numerator / depth
