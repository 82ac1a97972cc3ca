"""The layer with Gaussians that follow the skeleton: a small file of points for viewers that skin points (usdview), and
the stand-in that is shown where splats are not.

They are at rest, with a skin; the interface binds them to the skeleton of the rig. What training adds to a pose, and
how Gaussians shrink and stretch, is in the splats and points of every frame alone. The joints' scales are halves, which
moves a point by up to 0.04 mm. Prims:

    /Points   all of them, for variant points_skinned
    /Proxy    every tenth, larger, purpose proxy, for variant splats
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel

from jghand_engine.export.usd.layers import TYPES, TimeRange, display_primvars, new_layer, uniform
from jghand_engine.export.usd.skeleton import skin_influences
from jghand_engine.export.usd.splats import Cloud, bound
from jghand_engine.export.usd.values import floats, ids, ints, vec3f
from jghand_engine.limits import USD_PROXY_STEP, USD_SKIN_BONES

ALL_PATH = "/Points"
PROXY_PATH = "/Proxy"


@dataclass(frozen=True)
class SkinnedCloud:
    """cloud: the Gaussians at rest · bone_weights: (N, 21), level order · width_factor: diameter of a point in two
    standard deviations."""

    cloud: Cloud
    bone_weights: np.ndarray
    width_factor: float = 1.0


def write_skinned(path: Path, points: SkinnedCloud, time: TimeRange) -> None:
    """Writes both prims."""
    stage = new_layer(path, time)
    stage.SetDefaultPrim(_add_points(stage, ALL_PATH, points, 1))
    proxy = _add_points(stage, PROXY_PATH, points, USD_PROXY_STEP)
    uniform(proxy, "purpose", TYPES.Token, UsdGeom.Tokens.proxy)
    stage.Save()


def _add_points(stage: Usd.Stage, path: str, points: SkinnedCloud, step: int) -> Usd.Prim:
    """Every `step`-th Gaussian: Gaussians are in farthest-point order, so these cover the hand evenly. Fewer points
    are larger, as their distance on a surface grows."""
    cloud, part = points.cloud, slice(None, None, step)
    prim = UsdGeom.Points.Define(stage, path)
    radii_m = points.width_factor * np.sqrt(step) * cloud.sigma_m[part]
    prim.CreatePointsAttr(vec3f(cloud.rest_m[part]))
    prim.CreateWidthsAttr(floats(2 * radii_m))
    prim.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    prim.CreateExtentAttr(vec3f(bound(cloud.rest_m[part], radii_m)))
    # which of the splats it is: skinning tools may sort
    prim.CreateIdsAttr(ids(np.arange(len(cloud.sigma_m))[part]))
    display_primvars(prim.GetPrim(), cloud.rgb[part], cloud.opacity[part])
    joints, weights = skin_influences(points.bone_weights[part].astype(np.float64), most=USD_SKIN_BONES, fine=False)
    # not applied yet: alone, without a skeleton, these are points
    binding = UsdSkel.BindingAPI(prim)
    binding.CreateJointIndicesPrimvar(False, joints.shape[1]).Set(ints(joints))
    binding.CreateJointWeightsPrimvar(False, weights.shape[1]).Set(floats(weights))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    return prim.GetPrim()
