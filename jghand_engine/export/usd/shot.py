"""The shot: the hand and the cameras of a scene (EXPORT 8). Lights go here too, by whoever uses it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pxr import Gf, Kind, Sdf, Usd, UsdGeom

from jghand_engine.export.usd.stage import LayerNames, TimeRange, announce_fallback, matrix4d, new_layer
from jghand_engine.hand.orders import hand_length
from jghand_engine.native.contract import Z_NEAR_M
from jghand_engine.render.camera import Camera

# OpenCV looks along +z with y down, USD along -z with y up
USD_FROM_OPENCV_AXES = np.diag([1.0, -1.0, -1.0])
# horizontal aperture that cameras are written with: 36 mm in tenths of the stage's unit, the meter. Ratios alone make
# the field of view, but depth of field and the lens that a reader shows follow from the size
APERTURE = 0.36
# the clipping of an exported camera leaves this factor before and behind the hand, for what else the scene holds
CLIPPING_ROOM = 2.0


def write_shot(
    folder: Path, names: LayerNames, cameras: Mapping[str, Camera], joints_m: np.ndarray, time: TimeRange
) -> None:
    """/World with the hand and its cameras, which see joints_m (F, 21, 3). Cameras are no siblings of the default prim:
    validators refuse that."""
    stage = new_layer(folder / names.shot, time)
    world = UsdGeom.Xform.Define(stage, "/World").GetPrim()
    stage.SetDefaultPrim(world)
    announce_fallback(stage)
    Usd.ModelAPI(world).SetKind(Kind.Tokens.assembly)
    stage.DefinePrim("/World/Hand").GetReferences().AddReference(f"./{names.interface}")
    UsdGeom.Scope.Define(stage, "/World/Cameras")
    for name, camera in cameras.items():
        add_camera(stage, f"/World/Cameras/{name}", camera, joints_m)
    stage.Save()


def add_camera(stage: Usd.Stage, path: Sdf.Path | str, camera: Camera, joints_m: np.ndarray) -> UsdGeom.Camera:
    """Writes `camera` at `path`: one transform, focal length and apertures as ratios, the principal point as aperture
    offsets. Projects as the engine's camera does, to 1e-5 px. joints_m: (F, 21, 3) what it has to see, level order."""
    prim = UsdGeom.Camera.Define(stage, path)
    focal = camera.fx * APERTURE / camera.width
    vertical = camera.height * focal / camera.fy
    prim.CreateHorizontalApertureAttr(APERTURE)
    prim.CreateVerticalApertureAttr(vertical)
    prim.CreateFocalLengthAttr(focal)
    prim.CreateHorizontalApertureOffsetAttr(APERTURE * (0.5 - camera.cx / camera.width))
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
    near_m = max((float(depth_m.min()) - reach_m) / CLIPPING_ROOM, Z_NEAR_M)
    far_m = CLIPPING_ROOM * max(float(depth_m.max()) + reach_m, near_m)
    return near_m, far_m
