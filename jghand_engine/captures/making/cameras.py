"""Where the cameras of a capture stand: all around the hand, from above and below too. Close-ups: close_ups.py.

Every camera frames all poses as large as they fit, which puts its principal point off the center of the image, as in
real rigs. Pinholes with square pixels, OpenCV axes.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from jghand_engine.render.camera import Camera

# distance from the middle of the hands, meters: like the stages of the data sets
DISTANCE_M = (0.8, 1.1)
# largest roll about the viewing direction, degrees
ROLL_DEG = 12.0
# part of the image left free on each side of all poses
MARGIN = 0.03
# height of the viewing direction beyond which it is steep, and the image's upper edge is no longer the fingers' way
STEEP = 0.85

# the golden angle: points of a Fibonacci sphere
_GOLDEN_ANGLE = np.pi * (3 - 5**0.5)


@dataclass(frozen=True)
class PlannedCamera:
    """pose: the only one that it sees; None: all · samples: rays per pixel; None: those of the capture"""

    camera: Camera
    pose: int | None = None
    samples: int | None = None


def plan_cameras(count: int, size_px: tuple[int, int], seed: int, vertices_m: np.ndarray) -> list[PlannedCamera]:
    """Cameras for posed hands (P, V, 3), meters. Every vertex of every pose is inside the image of each.

    size_px: width, height · seed: of the distances and rolls
    """
    random = np.random.default_rng(seed)
    points = vertices_m.reshape(-1, 3)
    center = (points.min(0) + points.max(0)) / 2
    cameras = []
    for direction in sphere_directions(count, float(random.uniform(0, 2 * np.pi))):
        eye = center + random.uniform(*DISTANCE_M) * direction
        roll = np.radians(random.uniform(-1, 1) * ROLL_DEG)
        cameras.append(PlannedCamera(framed(aimed(eye, center, roll, size_px), points)))
    return cameras


def sphere_directions(count: int, start_rad: float) -> np.ndarray:
    """(count, 3) unit vectors spread evenly over the sphere, from the top (+y) to the bottom."""
    height = 1 - 2 * (np.arange(count) + 0.5) / max(count, 1)
    angle = start_rad + _GOLDEN_ANGLE * np.arange(count)
    around = np.sqrt(1 - height**2)
    return np.stack([around * np.sin(angle), height, around * np.cos(angle)], axis=1)


def framed(camera: Camera, points_m: np.ndarray) -> Camera:
    """The camera with the focal length and principal point that show all points (N, 3) as large as they fit."""
    seen = points_m @ camera.camera_from_world[:3, :3].T + camera.camera_from_world[:3, 3]
    slopes = seen[:, :2] / seen[:, 2:]
    low, high = slopes.min(0), slopes.max(0)
    room = (1 - 2 * MARGIN) * np.array([camera.width, camera.height])
    focal = float((room / (high - low)).min())
    cx, cy = np.array([camera.width, camera.height]) / 2 - focal * (low + high) / 2
    return replace(camera, fx=focal, fy=focal, cx=float(cx), cy=float(cy))


def aimed(eye: np.ndarray, target: np.ndarray, roll_rad: float, size_px: tuple[int, int]) -> Camera:
    """A camera without a focal length yet, the fingers upwards in the image where that can be."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    # from above and from below: the palm towards the lower edge
    up = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < STEEP else np.array([0.0, 0.0, -1.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    up = np.cos(roll_rad) * np.cross(right, forward) + np.sin(roll_rad) * right
    return Camera.looking_at(eye, target, up, width=size_px[0], height=size_px[1], focal_px=float(size_px[1]))
