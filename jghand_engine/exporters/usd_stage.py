"""The two small layers that people open: the hand with its variants, and the shot with the cameras (EXPORT 3, 8)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import numpy as np
from pxr import Kind, Sdf, Usd, UsdGeom

from jghand_engine import __version__
from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.exporters.usd_cameras import add_camera
from jghand_engine.exporters.usd_layers import TYPES, TimeRange, announce_fallback, new_layer, uniform
from jghand_engine.exporters.usd_splats import POINTS_PATH
from jghand_engine.hand.joints import Handedness
from jghand_engine.splat.camera import Camera

VARIANT_SET = "representation"


class Variant(StrEnum):
    """What of the hand is drawn. Blender up to 5.2 cannot choose: it takes what the file says."""

    SPLATS = "splats"
    POINTS = "points"
    MESH = "mesh"


@dataclass(frozen=True)
class LayerNames:
    """File names of one export, all in one folder."""

    name: str

    @property
    def interface(self) -> str:
        return f"{self.name}.usda"

    @property
    def rig(self) -> str:
        return f"{self.name}.rig.usdc"

    @property
    def splats(self) -> str:
        return f"{self.name}.splats.usdc"

    @property
    def shot(self) -> str:
        return f"{self.name}.shot.usda"

    @property
    def all(self) -> tuple[str, ...]:
        """Every file, those that refer to others after them."""
        return self.rig, self.splats, self.interface, self.shot


def write_interface(
    folder: Path,
    names: LayerNames,
    info: AvatarInfo,
    about: Mapping[str, object],
    stamp: Mapping[str, str],
    time: TimeRange,
    default: Variant,
) -> None:
    """The layer that others reference: /Hand with the rig and the variants, heavy layers as payloads.

    about: what is written as customData `jghand` of the hand, by name · stamp: what it was made from, as
    customLayerData `jghand`.
    """
    stage = new_layer(folder / names.interface, time)
    # an Xform: a SkelRoot here would stop the bounds at what is skinned, and the splats would have none
    hand = UsdGeom.Xform.Define(stage, "/Hand").GetPrim()
    stage.SetDefaultPrim(hand)
    announce_fallback(stage)
    stage.GetRootLayer().customLayerData = {"creator": f"JGHand {__version__}", "jghand": dict(stamp)}
    model = Usd.ModelAPI(hand)
    model.SetKind(Kind.Tokens.component)
    model.SetAssetName(info.name)
    model.SetAssetVersion(__version__)
    model.SetAssetIdentifier(Sdf.AssetPath(f"./{names.interface}"))
    for key, value in about.items():
        hand.SetCustomDataByKey(f"jghand:{key}", value)
    stage.DefinePrim("/Hand/Rig", "SkelRoot").GetReferences().AddReference(f"./{names.rig}")
    variants = hand.GetVariantSets().AddVariantSet(VARIANT_SET)
    for variant in Variant:
        variants.AddVariant(variant)
        variants.SetVariantSelection(variant)
        with variants.GetVariantEditContext():
            _fill_variant(stage, variant, names)
    variants.SetVariantSelection(default)
    stage.Save()


def _fill_variant(stage: Usd.Stage, variant: Variant, names: LayerNames) -> None:
    if variant is not Variant.MESH:
        uniform(stage.OverridePrim("/Hand/Rig/Mesh"), "purpose", TYPES.Token, UsdGeom.Tokens.guide)
    if variant is Variant.SPLATS:
        stage.OverridePrim("/Hand/Splats").GetPayloads().AddPayload(f"./{names.splats}")
    if variant is Variant.POINTS:
        # the data is a class prim; here it becomes a real one
        points = stage.DefinePrim("/Hand/Points")
        points.GetPayloads().AddPayload(f"./{names.splats}", POINTS_PATH)


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


def describe(avatar: HandAvatar, handedness: Handedness, *, sizes: str, radiance: str) -> dict[str, object]:
    """customData of the hand: what a client cannot see from the attributes. imageState is that of the radiance."""
    learnt = avatar.learnt
    return {
        "gaussians": len(avatar),
        "handedness": str(handedness),
        "imageState": IMAGE_STATES[radiance],
        "licence": avatar.info.licence,
        # learnt pose offsets are in the per-frame positions; the skinned mesh shows plain skinning
        "offsets": "none" if learnt is None or learnt.correctives is None else "in the positions of the splats",
        "colours": "constant" if learnt is None else "per frame, in the light of the capture",
        "gloss": "none" if learnt is None else "left out: it depends on the camera",
        "sizes": sizes,
    }
