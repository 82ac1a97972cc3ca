"""Pinhole cameras as USD cameras (EXPORT 8)."""

from __future__ import annotations

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom

from jghand_engine.export.usd.values import matrix4d
from jghand_engine.hand.orders import hand_length
from jghand_engine.limits import USD_APERTURE, USD_CLIPPING_ROOM, Z_NEAR_M
from jghand_engine.render.camera import Camera

# OpenCV looks along +z with y down, USD along -z with y up
USD_FROM_OPENCV_AXES = np.diag([1.0, -1.0, -1.0])


def add_camera(stage: Usd.Stage, path: Sdf.Path | str, camera: Camera, joints_m: np.ndarray) -> UsdGeom.Camera:
    """Writes `camera` at `path`: one transform, focal length and apertures as ratios, the principal point as aperture
    offsets. Projects as the engine's camera does, to 1e-5 px. joints_m: (F, 21, 3) what it has to see, level order."""
    prim = UsdGeom.Camera.Define(stage, path)
    focal = camera.fx * USD_APERTURE / camera.width
    vertical = camera.height * focal / camera.fy
    prim.CreateHorizontalApertureAttr(USD_APERTURE)
    prim.CreateVerticalApertureAttr(vertical)
    prim.CreateFocalLengthAttr(focal)
    prim.CreateHorizontalApertureOffsetAttr(USD_APERTURE * (0.5 - camera.cx / camera.width))
    prim.CreateVerticalApertureOffsetAttr(vertical * (camera.cy / camera.height - 0.5))
    prim.CreateClippingRangeAttr(Gf.Vec2f(*clipping_range_m(camera, joints_m)))
    world_from_camera = np.linalg.inv(camera.camera_from_world)
    world_from_camera[:3, :3] = world_from_camera[:3, :3] @ USD_FROM_OPENCV_AXES
    UsdGeom.Xformable(prim).AddTransformOp().Set(matrix4d(world_from_camera))
    return prim


def clipping_range_m(camera: Camera, joints_m: np.ndarray) -> tuple[float, float]:
    """Near and far plane around the hand in every frame, meters, with room before and behind; near at least the
    engine's. joints_m: (F, 21, 3) level order. No skin is further from its joint than the hand is long."""
    _, depth_m = camera.project(joints_m)
    reach_m = hand_length(joints_m)
    near_m = max((float(depth_m.min()) - reach_m) / USD_CLIPPING_ROOM, Z_NEAR_M)
    far_m = USD_CLIPPING_ROOM * max(float(depth_m.max()) + reach_m, near_m)
    return near_m, far_m
