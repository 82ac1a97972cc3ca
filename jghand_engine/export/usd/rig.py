"""The layers that follow the skeleton: the armature with the template mesh bound to it, and Gaussians at rest as
skinned points, a small file for viewers that skin points (usdview), a tenth of them as stand-in for splats.

A bone transform of the engine is B_i = S_i diag(r_i, r_i, s_i) S_i^cT between the pivots (METHOD 2.6): a rotation, a
radius r_i and a stretch s_i along the bone. So that UsdSkel moves a mesh exactly as the engine does, the skeleton has,
in this order,

* 21 **control** joints, named as everywhere. Rotation = frame of the bone that *starts* at the joint (the wrist has the
  palm's, a tip the last bone's), translation = bone length, scale 1, which therefore never inherits down a chain;
* 21 **skin** leaves, one per bone matrix, which carry the scale. `wrist/index1/index2_skin` moves the segment that
  *ends* at index2, where it sits (B_i maps both ends exactly, so either end can be the pivot, and at the far one
  Blender draws bones in their true length); `wrist/palm_skin` is B_0. Only these and the next have skin weights;
* of a hand with a forearm a leaf for each slice of it, `wrist/forearm1_skin` and so on, which turn about the wrist;
* as many **fine** leaves beside them. UsdSkel stores scales as half, 11 bits: 0.04 mm at the end of a metacarpal. A
  fixed share FINE_SHARE of every weight goes to a twin whose scale is overdrawn by the rounding error of the first:
  (1 - share) coarse + share fine = the scale to 19 bits. A sum with fixed weights stays right between samples, and a
  client that keeps only the four largest weights loses the twin's 1/256 and with it those 0.04 mm, nothing more.

Joint axes: x = flexion axis, y = along the bone, z = out of the palm, right-handed for both hands: the engine's
(y, z, x). Blender draws a bone along y. A left hand is the mirror image with the flexion axis turned round, so that
no scale is negative and positive flexion curls it too.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from jghand_engine.avatar.nearest import nearest_centers
from jghand_engine.avatar.relighting import Material
from jghand_engine.export.motion import BonePoses
from jghand_engine.export.usd.splats import Cloud
from jghand_engine.export.usd.stage import (
    PROXY_PATH,
    SKINNED_PATH,
    TYPES,
    TimeRange,
    bound,
    floats,
    ints,
    new_layer,
    quatf,
    set_display,
    set_uniform,
    vec3f,
    vec3h,
)
from jghand_engine.hand.joints import JOINT_COUNT, LEVEL_NAMES, PARENTS
from jghand_engine.hand.orders import LEVEL_OF_STANDARD, STANDARD_OF_LEVEL
from jghand_engine.hand.rotations import quaternions
from jghand_engine.template.mesh import HandTemplate
from jghand_engine.template.surface import vertex_normals

RIG_PATH = "/Rig"
# share of every skin weight that goes to the twin joint which carries what half precision lost of a scale; a power of
# two is exact in float32, and 2^-8 keeps the twin's scale within 12.5 % of the true one (2^-11 / 2^-8)
FINE_SHARE = 2.0**-8
# every so many-th Gaussian is in the stand-in that is shown where splats are not: a hand is still closed with a tenth
PROXY_STEP = 10
# bones that a Gaussian of the skinned variants follows at most: the hands that ship have 7. With 4, as many real-time
# clients have it, Gaussians of the palm are up to 3.8 mm off
SKIN_BONES = 8
# Gaussians around a vertex whose mean the mesh gets
NEIGHBORS = 8
# material of a mesh with textures
SKIN = "Skin"
# inputs of the material: of which kind, as input and as read, and the primvar that is read
_READ = {
    "diffuseColor": ("float3", TYPES.Color3f, TYPES.Float3, "displayColor"),
    "roughness": ("float", TYPES.Float, TYPES.Float, "roughness"),
    "ior": ("float", TYPES.Float, TYPES.Float, "ior"),
}
# those that a texture may be: of which kind, and its color space, scale and bias. What makes -1..1 of the bytes of a
# normal stands in the specification of UsdPreviewSurface
_PICTURED = {
    "diffuseColor": (TYPES.Color3f, "sRGB", None, None),
    "normal": (TYPES.Normal3f, "raw", (2, 2, 2, 1), (-1, -1, -1, 0)),
}


@dataclass(frozen=True)
class LocalPoses:
    """Joints of the skeleton relative to their parents over F frames.

    translations_m: (F, J, 3), J = 63, with a forearm two more for each slice
    rotations_xyzw: (F, J, 4), each on the side of the frame before
    scales: (F, J, 3), values that half precision holds exactly
    """

    translations_m: np.ndarray
    rotations_xyzw: np.ndarray
    scales: np.ndarray


@dataclass(frozen=True)
class UsdSkeleton:
    """The skeleton at rest.

    tokens: J paths, parents first
    bind, rest: (J, 4, 4) world and local transforms of the rest pose, acting on column vectors
    default: the rest pose as one frame
    """

    tokens: tuple[str, ...]
    bind: np.ndarray
    rest: np.ndarray
    default: LocalPoses


def joint_tokens(slices: int = 0) -> tuple[str, ...]:
    """The paths of all joints: control joints in standard order, then skin and fine leaves in the same order, each with
    those of a forearm's slices behind them."""
    paths: dict[int, str] = {}
    for level, name in enumerate(LEVEL_NAMES):
        paths[level] = f"{paths[PARENTS[level]]}/{name}" if level else name
    leaves = [
        f"{paths[max(PARENTS[level], 0)]}/{LEVEL_NAMES[level] if level else 'palm'}_skin" for level in LEVEL_OF_STANDARD
    ]
    leaves += [f"{paths[0]}/forearm{number}_skin" for number in range(1, slices + 1)]
    return (*(paths[level] for level in LEVEL_OF_STANDARD), *leaves, *(f"{leaf}_fine" for leaf in leaves))


def build_skeleton(rest: BonePoses) -> UsdSkeleton:
    rotations, positions_m = _world(rest)
    local_rotations, local_positions_m = _local(rotations, positions_m)
    return UsdSkeleton(
        joint_tokens(rest.axes.shape[1] - JOINT_COUNT), _homogeneous(rotations[0], positions_m[0]),
        _homogeneous(local_rotations[0], local_positions_m[0]), _local_poses(rest),
    )  # fmt: skip


def in_motion(skeleton: UsdSkeleton, batches: Iterable[BonePoses]) -> Iterator[LocalPoses]:
    """The skeleton's joints in the poses of a motion, which comes in parts; rotations go on from the rest pose."""
    before = skeleton.default.rotations_xyzw[-1:]
    for batch in batches:
        poses = _local_poses(batch)
        turned = same_hemisphere(np.concatenate([before, poses.rotations_xyzw]))[1:]
        before = turned[-1:]
        yield replace(poses, rotations_xyzw=turned)


def _local_poses(poses: BonePoses) -> LocalPoses:
    rotations, positions_m = _local(*_world(poses))
    coarse, fine = split_scales(poses.scales[:, _leaves(poses)])
    scales = np.concatenate([np.ones_like(coarse[:, :JOINT_COUNT]), coarse, fine], axis=1)
    return LocalPoses(positions_m, same_hemisphere(quaternions(rotations)[..., [1, 2, 3, 0]]), scales)


def _leaves(poses: BonePoses) -> list[int]:
    """The maps in the order of their leaves: bones in standard order, slices behind them."""
    return [*LEVEL_OF_STANDARD, *range(JOINT_COUNT, poses.axes.shape[1])]


def split_scales(scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two arrays of half-precision values with (1 - share) * coarse + share * fine = scales to 2^-19 of them."""
    coarse = scales.astype(np.float16).astype(np.float64)
    fine = coarse + (scales - coarse) / FINE_SHARE
    return coarse, fine.astype(np.float16).astype(np.float64)


def same_hemisphere(quaternions: np.ndarray) -> np.ndarray:
    """Quaternions (F, J, 4) with the sign that is nearest to the frame before: clients interpolate between samples."""
    turn = np.sign((quaternions[1:] * quaternions[:-1]).sum(-1, keepdims=True))
    turn = np.cumprod(np.where(turn < 0, -1.0, 1.0), axis=0)
    return np.concatenate([quaternions[:1], quaternions[1:] * turn])


def skin_influences(
    map_weights: np.ndarray, *, most: int = JOINT_COUNT, fine: bool = True
) -> tuple[np.ndarray, np.ndarray]:
    """Joint indices and weights from those of `HandAvatar.map_weights` (V, 21 or more), level order; K = most maps of
    any vertex, at most `most`.

    What lies beyond that is shared out among the others, nothing else is dropped. The K shares of the skin leaves come
    first, in falling order, then those of their fine twins: (V, 2K). Without `fine` there are no twins: (V, K), and
    the skin is as exact as half precision.
    """
    weights = np.array(map_weights, np.float64)
    # slices add what differs from the palm: beside it they take their part of its weight
    weights[:, 0] = (weights[:, 0] - weights[:, JOINT_COUNT:].sum(axis=1)).clip(0)
    leaf = np.array([*STANDARD_OF_LEVEL, *range(JOINT_COUNT, weights.shape[1])])
    count = max(1, int((weights > 0).sum(axis=1).max(initial=0)))
    bone = np.argsort(-weights, axis=1, kind="stable")[:, : min(most, count)]
    weight = np.take_along_axis(weights, bone, axis=1)
    if most < count:
        weight = weight / weight.sum(axis=1, keepdims=True)
    # unused slots point at the first joint: a weight of 0 on whatever joint means nothing
    skin = np.where(weight > 0, JOINT_COUNT + leaf[bone], 0)
    if not fine:
        return skin, weight
    twin = np.where(weight > 0, skin + len(leaf), 0)
    return (
        np.concatenate([skin, twin], axis=1),
        np.concatenate([weight * (1 - FINE_SHARE), weight * FINE_SHARE], axis=1),
    )


def _world(poses: BonePoses) -> tuple[np.ndarray, np.ndarray]:
    level, leaves = list(LEVEL_OF_STANDARD), _leaves(poses)
    starts = [0 if bone == 0 else bone + 5 if bone <= 15 else bone for bone in level]
    rotations = np.concatenate([poses.axes[:, starts], poses.axes[:, leaves], poses.axes[:, leaves]], axis=1)
    # slices turn about the wrist
    ends = [bone if bone < JOINT_COUNT else 0 for bone in leaves]
    return rotations, np.concatenate([poses.joints_m[:, places] for places in (level, ends, ends)], axis=1)


def _local(rotations: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same relative to the parents; the wrist stays in the world."""
    control = [STANDARD_OF_LEVEL[max(PARENTS[level], 0)] for level in LEVEL_OF_STANDARD]
    slices = [0] * ((rotations.shape[1] - 3 * len(control)) // 2)
    parent = np.array(control + 2 * (control + slices))
    to_parent = rotations[:, parent].swapaxes(-1, -2)
    local_rotations = to_parent @ rotations
    local_positions = (to_parent @ (positions - positions[:, parent])[..., None])[..., 0]
    local_rotations[:, 0], local_positions[:, 0] = rotations[:, 0], positions[:, 0]
    return local_rotations, local_positions


def _homogeneous(rotations: np.ndarray, positions: np.ndarray) -> np.ndarray:
    matrices = np.zeros((*rotations.shape[:-2], 4, 4))
    matrices[..., :3, :3], matrices[..., :3, 3], matrices[..., 3, 3] = rotations, positions, 1
    return matrices


# ---- layers ---------------------------------------------------------------------------------------------------------


def write_rig(
    path: Path,
    skeleton: UsdSkeleton,
    motion: Iterable[LocalPoses],
    skin: HandTemplate,
    map_weights: np.ndarray,
    material: Material,
    pictures: Mapping[str, str],
    time: TimeRange,
) -> None:
    """Writes /Rig with Skeleton, Skeleton/Anim, Mesh and its material Look. One prim at the root, so that one
    reference brings everything: separate references would drop skel:skeleton with a mere warning.

    motion:   of the skeleton, in parts that are saved one by one
    skin:     the surface of the hand itself, mirrored for a left one; map_weights: (V, 21 or more) of its vertices
    material: of its vertices
    pictures: files of textures, relative to this, by the input of the material that they are; without an albedo that of
              the vertices is all
    """
    stage = new_layer(path, time)
    root = UsdSkel.Root.Define(stage, RIG_PATH).GetPrim()
    stage.SetDefaultPrim(root)
    prim = UsdSkel.Skeleton.Define(stage, f"{RIG_PATH}/Skeleton")
    prim.CreateJointsAttr(skeleton.tokens)
    prim.CreateBindTransformsAttr(_matrices(skeleton.bind))
    prim.CreateRestTransformsAttr(_matrices(skeleton.rest))
    animation = UsdSkel.Animation.Define(stage, f"{RIG_PATH}/Skeleton/Anim")
    UsdSkel.BindingAPI.Apply(prim.GetPrim()).CreateAnimationSourceRel().SetTargets([animation.GetPath()])
    _add_mesh(stage, skin, map_weights, material, pictures, prim)
    animation.CreateJointsAttr(skeleton.tokens)
    translations, rotations = animation.CreateTranslationsAttr(), animation.CreateRotationsAttr()
    scales = animation.CreateScalesAttr()

    def put(poses: LocalPoses, index: int, at: Usd.TimeCode) -> None:
        translations.Set(vec3f(poses.translations_m[index]), at)
        rotations.Set(quatf(poses.rotations_xyzw[index]), at)
        scales.Set(vec3h(poses.scales[index]), at)

    # Default values are the rest pose: Blender and others read them before any sample
    put(skeleton.default, 0, Usd.TimeCode.Default())
    frame = 0
    for poses in motion:
        for index in range(len(poses.scales)):
            put(poses, index, time.code(frame))
            frame += 1
        stage.Save()
    stage.Save()


def _add_mesh(
    stage: Usd.Stage,
    template: HandTemplate,
    map_weights: np.ndarray,
    material: Material,
    pictures: Mapping[str, str],
    skeleton: UsdSkel.Skeleton,
) -> None:
    mesh = UsdGeom.Mesh.Define(stage, f"{RIG_PATH}/Mesh")
    mesh.CreatePointsAttr(vec3f(template.vertices_m))
    mesh.CreateFaceVertexIndicesAttr(ints(template.faces))
    mesh.CreateFaceVertexCountsAttr(ints(np.full(len(template.faces), 3)))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(vec3f(vertex_normals(template.vertices_m, template.faces)))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateExtentAttr(vec3f(np.stack([template.vertices_m.min(axis=0), template.vertices_m.max(axis=0)])))
    set_display(mesh.GetPrim(), material.albedo, material=material)
    look = _add_look(stage, f"{RIG_PATH}/Look")
    if pictures:
        look = _add_look(stage, f"{RIG_PATH}/{SKIN}", pictures)
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(look)
    corners, index = np.unique(template.face_uv.reshape(-1, 2), axis=0, return_inverse=True)
    coordinates = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", TYPES.TexCoord2fArray, UsdGeom.Tokens.faceVarying)
    coordinates.Set(Vt.Vec2fArray.FromNumpy(np.ascontiguousarray(corners, np.float32)))
    coordinates.SetIndices(ints(index))
    joints, weights = skin_influences(map_weights)
    binding = UsdSkel.BindingAPI.Apply(mesh.GetPrim())
    binding.CreateJointIndicesPrimvar(False, joints.shape[1]).Set(ints(joints))
    binding.CreateJointWeightsPrimvar(False, weights.shape[1]).Set(floats(weights))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    binding.CreateSkeletonRel().SetTargets([skeleton.GetPath()])


def _add_look(stage: Usd.Stage, path: str, pictures: Mapping[str, str] | None = None) -> UsdShade.Material:
    """A surface that light falls on, with the albedo, roughness and index of refraction of what has it. pictures: files
    of textures by the input that they are, instead of that or beside it"""
    look, pictures = UsdShade.Material.Define(stage, path), pictures or {}
    surface = UsdShade.Shader.Define(stage, f"{path}/Surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    for name, (kind, input_kind, read_kind, primvar) in _READ.items():
        if name not in pictures:
            read = _add_reader(stage, f"{path}/{name}", kind, primvar, read_kind)
            surface.CreateInput(name, input_kind).ConnectToSource(read)
    for name, file in pictures.items():
        input_kind, space, scale, bias = _PICTURED[name]
        texture = UsdShade.Shader.Define(stage, f"{path}/{name}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", TYPES.Asset).Set(Sdf.AssetPath(f"./{file}"))
        texture.CreateInput("sourceColorSpace", TYPES.Token).Set(space)
        for side in ("wrapS", "wrapT"):
            texture.CreateInput(side, TYPES.Token).Set("clamp")
        for change, values in (("scale", scale), ("bias", bias)):
            if values is not None:
                texture.CreateInput(change, TYPES.Float4).Set(Gf.Vec4f(*values))
        place = _add_reader(stage, f"{path}/st", "float2", "st", TYPES.Float2)
        texture.CreateInput("st", TYPES.Float2).ConnectToSource(place)
        surface.CreateInput(name, input_kind).ConnectToSource(texture.CreateOutput("rgb", TYPES.Float3))
    look.CreateSurfaceOutput().ConnectToSource(surface.CreateOutput("surface", TYPES.Token))
    return look


def _add_reader(stage: Usd.Stage, path: str, kind: str, primvar: str, read_kind: Any) -> UsdShade.Output:
    """What a shader that reads a primvar gives."""
    reader = UsdShade.Shader.Define(stage, path)
    reader.CreateIdAttr(f"UsdPrimvarReader_{kind}")
    reader.CreateInput("varname", TYPES.String).Set(primvar)
    return reader.CreateOutput("result", read_kind)


def vertex_material(vertices_m: np.ndarray, rest_m: np.ndarray, material: Material) -> Material:
    """Of vertices (V, 3): means of the Gaussians, whose centers (N, 3) are in the same pose, that are nearest."""
    values = np.column_stack([material.albedo, material.roughness, material.reflectance]).astype(np.float64)
    means = values[nearest_centers(vertices_m, rest_m, NEIGHBORS)].mean(axis=1)
    return Material(means[:, :3], means[:, 3], means[:, 4])


def write_skinned(path: Path, cloud: Cloud, map_weights: np.ndarray, width_factor: float, time: TimeRange) -> None:
    """Writes all Gaussians as /Points, and every tenth, larger, as /Proxy: at rest, with a skin, for the interface to
    bind to the rig's skeleton. What training adds to a pose, and how Gaussians shrink and stretch, is in the splats and
    points of every frame alone. The joints' scales are halves, which moves a point by up to 0.04 mm.

    map_weights: (N, 21 or more), level order
    width_factor: diameter of a point in two standard deviations
    """
    stage = new_layer(path, time)
    stage.SetDefaultPrim(_add_points(stage, SKINNED_PATH, cloud, map_weights, width_factor))
    some = slice(None, None, PROXY_STEP)
    # fewer points are larger, as their distance on a surface grows
    wider = width_factor * np.sqrt(PROXY_STEP)
    proxy = _add_points(stage, PROXY_PATH, cloud.every(PROXY_STEP), map_weights[some], wider, PROXY_STEP)
    set_uniform(proxy, "purpose", TYPES.Token, UsdGeom.Tokens.proxy)
    stage.Save()


def _add_points(
    stage: Usd.Stage, path: str, cloud: Cloud, map_weights: np.ndarray, width_factor: float, step: int = 1
) -> Usd.Prim:
    """Points that are every `step`-th Gaussian: Gaussians are in farthest-point order, so these cover the hand."""
    prim = UsdGeom.Points.Define(stage, path)
    radii_m = width_factor * cloud.sigma_m
    prim.CreatePointsAttr(vec3f(cloud.rest_m))
    prim.CreateWidthsAttr(floats(2 * radii_m))
    prim.SetWidthsInterpolation(UsdGeom.Tokens.vertex)
    prim.CreateExtentAttr(bound(cloud.rest_m, radii_m))
    # which of the splats it is: skinning tools may sort
    prim.CreateIdsAttr(Vt.Int64Array.FromNumpy(step * np.arange(len(cloud.sigma_m))))
    set_display(prim.GetPrim(), *cloud.display)
    joints, weights = skin_influences(map_weights, most=SKIN_BONES, fine=False)
    # not applied yet: alone, without a skeleton, these are points
    binding = UsdSkel.BindingAPI(prim)
    binding.CreateJointIndicesPrimvar(False, joints.shape[1]).Set(ints(joints))
    binding.CreateJointWeightsPrimvar(False, weights.shape[1]).Set(floats(weights))
    binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1))
    return prim.GetPrim()


def _matrices(matrices: np.ndarray) -> Vt.Matrix4dArray:
    return Vt.Matrix4dArray.FromNumpy(np.ascontiguousarray(matrices.transpose(0, 2, 1), np.float64))
