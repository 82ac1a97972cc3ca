# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own USD export gets the baked splats of the scene's hands; its import of our stages gets their colors.

Blender calls the hook with its stage when everything else is written. The splats come from the bake of each hand, made
by the engine before: its layers are put into a folder beside the exported file and referenced. A hand without a bake,
or with one of another pose or avatar, is left out and that is said. Nothing here may ever throw: Blender would end the
process. Blender's importer gives points no material, whatever is bound to them, so they would be gray.

Only registered where Blender's `pxr` can be imported, for the same reason. No reference to a stage outlives a call: USD
refuses to write a file whose layer somebody holds. Source: BLENDER 9.
"""

from __future__ import annotations

import traceback
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import bpy

from .. import ui
from ..core.files import copy_whole
from ..errors import JGHandFailure
from ..hand import armature, stand_ins
from . import bakes

SPLAT_TYPE = "ParticleField3DGaussianSplat"

_Hook: Any = getattr(bpy.types, "USDHook", object)  # a Blender may be built without USD


class JGHandUsdHook(_Hook):
    bl_idname = "jghand_usd_hook"
    bl_label = "JGHand Splats"
    bl_description = "Add the baked splats of JGHand hands to Blender's USD exports, and colors to its imports of them"

    @staticmethod
    def on_export(export_context: Any) -> bool:
        try:
            stage, depsgraph = export_context.get_stage(), export_context.get_depsgraph()
            drop_stand_ins(stage, depsgraph.scene)
            left_out = add_splats(stage, depsgraph)
        except Exception as error:
            # anything else that left here would take Blender and the artist's scene with it
            traceback.print_exc()
            left_out = [f"The splats were left out: {error}"]
        if left_out:  # Blender's export runs on a thread of its own
            ui.show_later(" ".join(["Not all hands are in the USD file.", *left_out]), icon="ERROR")
        return True

    @staticmethod
    def on_import(import_context: Any) -> bool:
        try:
            layers = import_context.get_stage().GetUsedLayers()
            if any("jghand" in layer.customLayerData for layer in layers):
                color_points(thing for things in import_context.get_prim_map().values() for thing in things)
        except Exception:  # as above
            traceback.print_exc()
        return True


def color_points(things: Iterable[bpy.types.ID]) -> None:
    """Gives point clouds without a material that of a bake's points, or one that lamps light where they have what that
    needs: they then carry no light."""
    for cloud in things:
        if isinstance(cloud, bpy.types.PointCloud) and not cloud.materials and "displayColor" in cloud.attributes:
            cloud.materials.append(bakes.points_material(lit="roughness" in cloud.attributes))


def drop_stand_ins(stage: Any, scene: bpy.types.Scene) -> None:
    """Takes what throws the hands' shadows in Blender out of a stage."""
    from pxr import Tf

    names = [thing.name for thing in scene.objects if stand_ins.MARK in thing] + [stand_ins.MATERIAL]
    identifiers = {Tf.MakeValidIdentifier(name) for name in names}
    for path in [prim.GetPath() for prim in stage.Traverse() if prim.GetName() in identifiers]:
        stage.RemovePrim(path)


def add_splats(stage: Any, depsgraph: bpy.types.Depsgraph) -> list[str]:
    """Puts the baked hands of a scene on Blender's stage; returns which were left out, in sentences."""
    whole = Path(stage.GetRootLayer().realPath)
    target = whole.with_name(f"{whole.stem}_jghand")
    left_out = []
    for thing in depsgraph.scene.objects:
        if not armature.is_any_hand(thing) or not _is_exported(stage, thing):
            continue
        try:
            folder = bakes.folder_of(thing)
            for hand in _usable_bakes(thing, folder, depsgraph):
                _bring_layers(hand, folder, target)
                _reference(stage, hand, depsgraph.scene, target.name)
        except JGHandFailure as failure:
            left_out.append(f"{thing.name}: left out. {failure}")
    return left_out


def _is_exported(stage: Any, thing: bpy.types.Object) -> bool:
    """Whether Blender wrote an object at all: selected ones only may have been asked for."""
    from pxr import Tf

    names = {thing.name, Tf.MakeValidIdentifier(thing.name)}
    return any(prim.GetName() in names for prim in stage.Traverse())


def _usable_bakes(thing: bpy.types.Object, folder: Path, depsgraph: bpy.types.Depsgraph) -> list[bakes.BakedHand]:
    """The bakes of a hand's object, when they still show it. JGHandFailure: no_bake, stale_bake."""
    if not thing.jghand.bake:
        raise JGHandFailure("no_bake", f"{thing.name} was not baked")
    found = bakes.read_bake(folder)
    reasons = bakes.stale_now(thing, depsgraph, found)
    if reasons:
        raise JGHandFailure("stale_bake", f"{thing.name}: {', '.join(reasons)}")
    return found


def _bring_layers(hand: bakes.BakedHand, folder: Path, target: Path) -> None:
    """Copies of the layers in a folder beside the exported file, so that both can be given away."""
    # layers first, then the one that refers to them; a hand's name has no dot in it
    for source in (*sorted(folder.glob(f"{hand.name}.*.usdc")), hand.stage(folder)):
        copy_whole(source, target / source.name)  # a disk that is full must not leave half a layer of an earlier export


def _reference(stage: Any, hand: bakes.BakedHand, scene: bpy.types.Scene, folder: str) -> None:
    """One prim under Blender's own root, so that it is turned and scaled as everything else is."""
    from pxr import Gf, UsdGeom, Vt

    unit_m = scene.unit_settings.scale_length
    root = stage.GetDefaultPrim()
    turn = Gf.Matrix4d(1.0)
    if root and "Blender" in root.GetCustomData():
        path = root.GetPath().AppendChild(hand.name)
        scale = 1.0 / unit_m
    else:
        # an export without a root: every object carries the turn and the unit itself
        path = f"/{hand.name}"
        scale = 1.0 / UsdGeom.GetStageMetersPerUnit(stage)
        if UsdGeom.GetStageUpAxis(stage) == UsdGeom.Tokens.y:
            turn.SetRotate(Gf.Rotation(Gf.Vec3d(1, 0, 0), -90))
    if stage.GetPrimAtPath(path):
        path = f"{path}_splats"
    prim = UsdGeom.Xform.Define(stage, path)
    prim.AddTransformOp().Set(Gf.Matrix4d(1.0).SetScale(scale) * turn)
    prim.GetPrim().GetReferences().AddReference(f"./{folder}/{hand.name}.usda")
    variants = prim.GetPrim().GetVariantSets().GetVariantSet("representation")
    # a bake of an older engine may lack it, and would show nothing
    if scene.jghand.output.variant in variants.GetVariantNames():
        variants.SetVariantSelection(scene.jghand.output.variant)
    # read from the root layer only: without it a USD that knows no splats shows nothing
    stage.SetMetadata("fallbackPrimTypes", {SPLAT_TYPE: Vt.TokenArray(["Points"])})
    if not stage.HasAuthoredTimeCodeRange():  # a still was exported: Blender wrote no times
        stage.SetStartTimeCode(hand.first_frame)
        stage.SetEndTimeCode(hand.last_frame)
        stage.SetTimeCodesPerSecond(hand.fps)


def can_hook() -> bool:
    """Whether this Blender's USD can be reached from Python; makes it so."""
    if not hasattr(bpy.types, "USDHook"):
        return False
    try:
        bpy.utils.expose_bundled_modules()
        from pxr import Usd  # noqa: F401 - what a hook's stage is made of
    except (ImportError, AttributeError):
        return False
    return True


def register() -> None:
    if can_hook():
        bpy.utils.register_class(JGHandUsdHook)


def unregister() -> None:
    if getattr(JGHandUsdHook, "is_registered", False):  # a Blender without USD gives its classes no such name
        bpy.utils.unregister_class(JGHandUsdHook)
