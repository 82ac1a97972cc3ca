"""The two small layers that people open: the hand with its variants, and the shot with the cameras (EXPORT 3, 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom, UsdSkel

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.export.usd.cameras import add_camera
from jghand_engine.export.usd.layers import TYPES, TimeRange, announce_fallback, new_layer, uniform
from jghand_engine.export.usd.options import LayerNames, UsdOptions, Variant
from jghand_engine.export.usd.skinned import ALL_PATH, PROXY_PATH
from jghand_engine.export.usd.splats import POINTS_PATH
from jghand_engine.hand.joints import Handedness
from jghand_engine.render.camera import Camera

VARIANT_SET = "representation"
HAND_PATH = "/Hand"
RIG_PATH = f"{HAND_PATH}/Rig"


@dataclass(frozen=True)
class Interface:
    """What the layer that others reference says. name: of the asset · about: customData `jghand` of the hand, by name ·
    variants: those it offers · default: the one that is chosen."""

    name: str
    about: Mapping[str, Any]
    variants: Sequence[Variant]
    default: Variant


def write_interface(folder: Path, names: LayerNames, interface: Interface, time: TimeRange) -> None:
    """The layer that others reference: /Hand with the rig and the variants, heavy layers as payloads."""
    stage = new_layer(folder / names.interface, time)
    # an Xform: a SkelRoot here would stop the bounds at what is skinned, and the splats would have none
    hand = UsdGeom.Xform.Define(stage, HAND_PATH).GetPrim()
    stage.SetDefaultPrim(hand)
    announce_fallback(stage)
    model = Usd.ModelAPI(hand)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(interface.name)
    model.SetAssetVersion(__version__)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{names.interface}"))
    for key, value in interface.about.items():
        hand.SetCustomDataByKey(f"jghand:{key}", value)
    stage.DefinePrim(RIG_PATH, "SkelRoot").GetReferences().AddReference(f"./{names.rig}")
    variants = hand.GetVariantSets().AddVariantSet(VARIANT_SET)
    for variant in interface.variants:
        variants.AddVariant(variant)
        variants.SetVariantSelection(variant)
        with variants.GetVariantEditContext():
            _fill_variant(stage, variant, names)
    variants.SetVariantSelection(interface.default)
    stage.Save()


def _fill_variant(stage: Usd.Stage, variant: Variant, names: LayerNames) -> None:
    if variant is not Variant.MESH:
        uniform(stage.OverridePrim(f"{RIG_PATH}/Mesh"), "purpose", TYPES.Token, UsdGeom.Tokens.guide)
    if variant is Variant.SPLATS:
        splats = stage.OverridePrim(f"{HAND_PATH}/Splats")
        splats.GetPayloads().AddPayload(f"./{names.splats}")
        # no payload: it stands in for what is not loaded too
        proxy = stage.OverridePrim(f"{RIG_PATH}/Proxy")
        proxy.GetReferences().AddReference(f"./{names.skinned}", PROXY_PATH)
        _bind(proxy)
        uniform(splats, "purpose", TYPES.Token, UsdGeom.Tokens.render)
        splats.CreateRelationship("proxyPrim", False).SetTargets([proxy.GetPath()])
    if variant is Variant.POINTS:
        # the data is a class prim; here it becomes a real one
        points = stage.DefinePrim(f"{HAND_PATH}/Points")
        points.GetPayloads().AddPayload(f"./{names.splats}", POINTS_PATH)
    if variant is Variant.POINTS_SKINNED:
        points = stage.OverridePrim(f"{RIG_PATH}/Points")
        points.GetPayloads().AddPayload(f"./{names.skinned}", ALL_PATH)
        _bind(points)


def _bind(points: Usd.Prim) -> None:
    """To the skeleton of the rig: the points come from another file, which cannot know it."""
    UsdSkel.BindingAPI.Apply(points).CreateSkeletonRel().SetTargets([Sdf.Path(f"{RIG_PATH}/Skeleton")])


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


IMAGE_STATES = {"srgb": "display-referred sRGB", "linear": "linear light"}


def describe(avatar: HandAvatar, handedness: Handedness, options: UsdOptions) -> dict[str, Any]:
    """customData of the hand: what a client cannot see from the attributes. imageState is that of the radiance."""
    learned = avatar.learned
    still = learned is None or learned.correctives is None
    return {
        "gaussians": len(avatar),
        "handedness": str(handedness),
        "imageState": IMAGE_STATES[options.radiance],
        "licence": avatar.info.license,
        # learned pose offsets are in the per-frame positions; what is skinned shows plain skinning
        "offsets": "none" if still else "in the positions of the splats",
        "skinnedOffsets": "none",
        "colors": "constant" if learned is None else "per frame, in the light of the capture",
        "gloss": "none" if learned is None else "left out: it depends on the camera",
        "sizes": options.sizes,
        "precision": options.precision,
    }
