"""The layer with the armature: skeleton, its animation, and the template mesh bound to it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdSkel
from scipy.spatial import KDTree

from jghand_engine.export.usd.layers import TYPES, TimeRange, display_primvars, new_layer
from jghand_engine.export.usd.skeleton import LocalPoses, UsdSkeleton, skin_influences
from jghand_engine.export.usd.splats import Cloud
from jghand_engine.export.usd.values import floats, ints, matrices4d, quatf, vec2f, vec3f, vec3h
from jghand_engine.limits import USD_MESH_COLOR_NEIGHBORS
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.surface import vertex_normals

RIG_PATH = "/Rig"


@dataclass(frozen=True)
class Rig:
    """motion: of the skeleton, in parts that are saved one by one · template: the surface of the hand itself, mirrored
    for a left one · rgb: (V, 3) display-referred sRGB of its vertices."""

    skeleton: UsdSkeleton
    motion: Iterable[LocalPoses]
    template: HandTemplate
    rgb: np.ndarray


def write_rig(path: Path, rig: Rig, time: TimeRange) -> None:
    """Writes /Rig with Skeleton, Skeleton/Anim and Mesh. One prim at the root, so that one reference brings everything:
    separate references would drop skel:skeleton with a mere warning."""
    stage = new_layer(path, time)
    root = UsdSkel.Root.Define(stage, RIG_PATH).GetPrim()
    stage.SetDefaultPrim(root)
    skeleton = UsdSkel.Skeleton.Define(stage, f"{RIG_PATH}/Skeleton")
    skeleton.CreateJointsAttr(rig.skeleton.tokens)
    skeleton.CreateBindTransformsAttr(matrices4d(rig.skeleton.bind))
    skeleton.CreateRestTransformsAttr(matrices4d(rig.skeleton.rest))
    animation = UsdSkel.Animation.Define(stage, f"{RIG_PATH}/Skeleton/Anim")
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    _add_mesh(stage, rig, skeleton)
    _animate(stage, animation, rig, time)


def _animate(stage: Usd.Stage, animation: UsdSkel.Animation, rig: Rig, span: TimeRange) -> None:
    animation.CreateJointsAttr(rig.skeleton.tokens)
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    scales = animation.CreateScalesAttr()

    def put(poses: LocalPoses, index: int, time: Usd.TimeCode) -> None:
        translations.Set(vec3f(poses.translations_m[index]), time)
        rotations.Set(quatf(poses.rotations_xyzw[index]), time)
        scales.Set(vec3h(poses.scales[index]), time)

    # Default values are the rest pose: Blender and others read them before any sample
    put(rig.skeleton.default, 0, Usd.TimeCode.Default())
    frame = 0
    for poses in rig.motion:
        for index in range(len(poses.scales)):
            put(poses, index, span.code(frame))
            frame += 1
        stage.Save()
    stage.Save()


def _add_mesh(stage: Usd.Stage, rig: Rig, skeleton: UsdSkel.Skeleton) -> None:
    template = rig.template
    mesh = UsdGeom.Mesh.Define(stage, f"{RIG_PATH}/Mesh")
    mesh.CreatePointsAttr(vec3f(template.vertices_m))
    mesh.CreateFaceVertexIndicesAttr(ints(template.faces))
    mesh.CreateFaceVertexCountsAttr(ints(np.full(len(template.faces), 3)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(vec3f(vertex_normals(template.vertices_m, template.faces)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateExtentAttr(vec3f(np.stack([template.vertices_m.min(axis=0), template.vertices_m.max(axis=0)])))
    display_primvars(mesh.GetPrim(), rig.rgb)
    corners, index = np.unique(template.face_uv.reshape(-1, 2), axis=0, return_inverse=True)
    coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    coordinates.Set(vec2f(corners))
    coordinates.SetIndices(ints(index))
    joints, weights = skin_influences(template.bone_weights)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(False, joints.shape[1]).Set(ints(joints))
    binding.CreateJointWeightsPrimvar(False, weights.shape[1]).Set(floats(weights))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])


def vertex_colors(vertices_m: np.ndarray, cloud: Cloud) -> np.ndarray:
    """(V, 3) display-referred sRGB: mean of the nearest Gaussians of a cloud in the same pose."""
    neighbors = min(USD_MESH_COLOR_NEIGHBORS, len(cloud.rgb))
    _, index = KDTree(cloud.rest_m).query(vertices_m, k=neighbors)
    return cloud.rgb[index.reshape(len(vertices_m), neighbors)].mean(axis=1)
