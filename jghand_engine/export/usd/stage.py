"""What every layer of a stage shares: units and time, untyped attributes, arrays in USD's types, what its errors mean;
and the small layer that people open, the hand with its variants (EXPORT 3)."""

from __future__ import annotations

import contextlib
import errno
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Gf, Kind, Sdf, Tf, Usd, UsdGeom, UsdShade, UsdSkel, Vt

from jghand_engine import __version__
from jghand_engine.avatar.detail import Detail
from jghand_engine.avatar.relighting import Material
from jghand_engine.errors import RetryError
from jghand_engine.files import file_error
from jghand_engine.motion.usd import usd_reason

SPLAT_TYPE = "ParticleField3DGaussianSplat"
LINEAR, SRGB = "lin_rec709_scene", "srgb_rec709_scene"
TYPES: Any = Sdf.ValueTypeNames

VARIANT_SET = "representation"
HAND_PATH = "/Hand"
RIG_PATH = f"{HAND_PATH}/Rig"
# the material of the rig's layer, as other layers find it
LOOK_PATH = f"{RIG_PATH}/Look"
# in the layer of the splats: the splats, and a class prim of points from the same numbers
SPLATS_PATH, POINTS_PATH = "/Splats", "/_Points"
# in the layer of points that follow the skeleton: all Gaussians, and the tenth that stands in for splats
SKINNED_PATH, PROXY_PATH = "/Points", "/Proxy"


class Variant(StrEnum):
    """What of the hand is drawn. Blender up to 5.2 cannot choose: it takes what the file says."""

    SPLATS = "splats"
    POINTS = "points"
    POINTS_SKINNED = "points_skinned"
    MESH = "mesh"


class LayerNames:
    """File names of one export, all in one folder."""

    def __init__(self, name: str) -> None:
        self.interface, self.shot = f"{name}.usda", f"{name}.shot.usda"
        self.rig, self.splats = f"{name}.rig.usdc", f"{name}.splats.usdc"
        # points that follow the skeleton: all of them, and the tenth that stands in for splats
        self.skinned = f"{name}.skinned.usdc"
        self._colors, self._normals = f"{name}.skin.png", f"{name}.normal.png"

    def pictures(self, detail: Detail | None) -> dict[str, str]:
        """Textures of the mesh, by the input of its material that they are."""
        if detail is None:
            return {}
        return {"diffuseColor": self._colors} | ({} if detail.relief is None else {"normal": self._normals})


@dataclass(frozen=True)
class TimeRange:
    """What all layers of an export agree on.

    frames: how many; one time code is one frame
    fps: frames per second
    first: number of the first frame
    up: the axis, y or z, that points up in the world of the motion; nothing is turned
    provenance: customLayerData of every layer, for each may be given away alone
    """

    frames: int
    fps: float
    first: int = 0
    up: str = "y"
    provenance: Mapping[str, Any] = field(default_factory=dict)

    def code(self, index: int) -> Usd.TimeCode:
        return Usd.TimeCode(self.first + index)


def new_layer(path: Path, time: TimeRange) -> Usd.Stage:
    """A new stage on `path` in meters, with what all layers agree on, written on `Save()`."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z if time.up == "z" else UsdGeom.Tokens.y)
    stage.SetTimeCodesPerSecond(time.fps)
    stage.SetFramesPerSecond(time.fps)
    stage.SetStartTimeCode(time.first)
    stage.SetEndTimeCode(time.first + time.frames - 1)
    if time.provenance:
        stage.GetRootLayer().customLayerData = dict(time.provenance)
    return stage


def announce_fallback(stage: Usd.Stage) -> None:
    """Lets a USD that is too old for splats show the prim as points. Read from the root layer only, so every layer
    that somebody may open first must say it."""
    stage.SetMetadata("fallbackPrimTypes", {SPLAT_TYPE: Vt.TokenArray(["Points"])})


def attribute(prim: Usd.Prim, name: str, type_name: Sdf.ValueTypeName) -> Usd.Attribute:
    """An attribute authored without its schema class: USD 25.08 does not know the splat schema, and `Imageable` does
    not accept a prim of unknown type."""
    return prim.CreateAttribute(name, type_name, False, Sdf.VariabilityVarying)


def set_uniform(prim: Usd.Prim, name: str, type_name: Sdf.ValueTypeName, value: Any) -> None:
    prim.CreateAttribute(name, type_name, False, Sdf.VariabilityUniform).Set(value)


def set_display(
    prim: Usd.Prim, rgb: np.ndarray, opacity: np.ndarray | None = None, material: Material | None = None
) -> None:
    """Viewport colors (N, 3), linear by convention, one per point. material: what the material Look reads beside its
    albedo, which is the colors then."""
    api = UsdGeom.PrimvarsAPI(prim)
    color = api.CreatePrimvar("displayColor", TYPES.Color3fArray, UsdGeom.Tokens.vertex)
    color.Set(vec3f(rgb))
    color.GetAttr().SetColorSpace(LINEAR)
    numbers = {} if opacity is None else {"displayOpacity": opacity}
    if material is not None:
        # the refractive index of what reflects this part of the light at right angles (Fresnel)
        root = np.sqrt(material.reflectance)
        numbers |= {"roughness": material.roughness, "ior": (1 + root) / (1 - root)}
    for name, values in numbers.items():
        api.CreatePrimvar(name, TYPES.FloatArray, UsdGeom.Tokens.vertex).Set(floats(values))


def bound(positions_m: np.ndarray, radius_m: np.ndarray) -> Vt.Vec3fArray:
    """Both corners of the box that holds every ball, meters."""
    # one axis per row: thirty times faster than along rows of three numbers
    rows = np.ascontiguousarray(positions_m.T)
    return vec3f(np.stack([(rows - radius_m).min(axis=1), (rows + radius_m).max(axis=1)]))


# ---- numpy arrays in USD's types -------------------------------------------------------------------------------------
# Always `FromNumpy`: lists of tuples cost 150 ms for 60,000 points, it costs 0.2 ms. Arrays of quaternions are
# x, y, z, w (so wants `FromNumpy`), and matrices act on column vectors here and on row vectors in USD.


def vec3f(array: np.ndarray) -> Vt.Vec3fArray:
    return Vt.Vec3fArray.FromNumpy(np.ascontiguousarray(array, np.float32))


def vec3h(array: np.ndarray) -> Vt.Vec3hArray:
    """(N, 3) numbers, rounded to half precision."""
    return Vt.Vec3hArray.FromNumpy(np.ascontiguousarray(array, np.float16))


def floats(array: np.ndarray) -> Vt.FloatArray:
    return Vt.FloatArray.FromNumpy(np.ascontiguousarray(array, np.float32).ravel())


def ints(array: np.ndarray) -> Vt.IntArray:
    return Vt.IntArray.FromNumpy(np.ascontiguousarray(array, np.int32).ravel())


def quatf(array_xyzw: np.ndarray) -> Vt.QuatfArray:
    """(N, 4) unit quaternions as x, y, z, w."""
    return Vt.QuatfArray.FromNumpy(np.ascontiguousarray(array_xyzw, np.float32))


def matrix4d(matrix: np.ndarray) -> Gf.Matrix4d:
    return Gf.Matrix4d(np.ascontiguousarray(matrix.T, np.float64))


# ---- the layer that others reference ---------------------------------------------------------------------------------


def write_interface(
    folder: Path,
    names: LayerNames,
    time: TimeRange,
    *,
    asset: str,
    about: Mapping[str, Any],
    variants: Sequence[Variant],
    default: Variant,
    lit: bool,
) -> None:
    """/Hand with the rig and the variants, heavy layers as payloads.

    asset:    its name
    about:    customData `jghand` of the hand, by name
    variants: those it offers
    default:  the one that is chosen
    lit:      whether points have the rig's material, too
    """
    stage = new_layer(folder / names.interface, time)
    # an Xform: a SkelRoot here would stop the bounds at what is skinned, and the splats would have none
    hand = UsdGeom.Xform.Define(stage, HAND_PATH).GetPrim()
    stage.SetDefaultPrim(hand)
    announce_fallback(stage)
    model = Usd.ModelAPI(hand)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(asset)
    model.SetAssetVersion(__version__)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{names.interface}"))
    for key, value in about.items():
        hand.SetCustomDataByKey(f"jghand:{key}", value)
    stage.DefinePrim(RIG_PATH, "SkelRoot").GetReferences().AddReference(f"./{names.rig}")
    offered = hand.GetVariantSets().AddVariantSet(VARIANT_SET)
    for variant in variants:
        offered.AddVariant(variant)
        offered.SetVariantSelection(variant)
        with offered.GetVariantEditContext():
            _fill_variant(stage, variant, names, lit=lit)
    offered.SetVariantSelection(default)
    stage.Save()


def _fill_variant(stage: Usd.Stage, variant: Variant, names: LayerNames, *, lit: bool) -> None:
    if variant is not Variant.MESH:
        set_uniform(stage.OverridePrim(f"{RIG_PATH}/Mesh"), "purpose", TYPES.Token, UsdGeom.Tokens.guide)
    if variant is Variant.SPLATS:
        splats = stage.OverridePrim(f"{HAND_PATH}/Splats")
        splats.GetPayloads().AddPayload(f"./{names.splats}")
        # no payload: it stands in for what is not loaded too
        proxy = stage.OverridePrim(f"{RIG_PATH}/Proxy")
        proxy.GetReferences().AddReference(f"./{names.skinned}", PROXY_PATH)
        _bind(proxy, lit=lit)
        set_uniform(splats, "purpose", TYPES.Token, UsdGeom.Tokens.render)
        splats.CreateRelationship("proxyPrim", False).SetTargets([proxy.GetPath()])
    if variant is Variant.POINTS:
        # the data is a class prim; here it becomes a real one
        points = stage.DefinePrim(f"{HAND_PATH}/Points")
        points.GetPayloads().AddPayload(f"./{names.splats}", POINTS_PATH)
        _bind_look(points, lit=lit)
    if variant is Variant.POINTS_SKINNED:
        points = stage.OverridePrim(f"{RIG_PATH}/Points")
        points.GetPayloads().AddPayload(f"./{names.skinned}", SKINNED_PATH)
        _bind(points, lit=lit)


def _bind(points: Usd.Prim, *, lit: bool) -> None:
    """To the skeleton of the rig: the points come from another file, which cannot know it."""
    UsdSkel.BindingAPI.Apply(points).CreateSkeletonRel().SetTargets([Sdf.Path(f"{RIG_PATH}/Skeleton")])
    _bind_look(points, lit=lit)


def _bind_look(points: Usd.Prim, *, lit: bool) -> None:
    if lit:
        binding = UsdShade.MaterialBindingAPI.Apply(points).GetDirectBindingRel()
        binding.SetTargets([Sdf.Path(LOOK_PATH)])


# ---- errors ----------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def usd_errors(folder: Path) -> Iterator[None]:
    """Turns what fails while a stage is written below `folder` into the engine's errors."""
    try:
        yield
    except OSError as error:
        raise file_error(folder, error) from error
    except Tf.ErrorException as error:
        text = str(error)
        for code in (errno.ENOSPC, errno.EDQUOT, errno.EACCES, errno.EROFS):
            if os.strerror(code) in text:
                raise file_error(folder, OSError(code, os.strerror(code))) from error
        raise RetryError(
            f"cannot write the USD stage in {folder}: {usd_reason(error)}", remedy="Check the disk and try again."
        ) from error
