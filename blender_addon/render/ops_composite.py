# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands in pictures of Cycles and EEVEE."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_rpt as rpt_

from ..hand import armature
from ..ops import UNDOABLE, Reporting, missing
from . import composite
from .engine_name import ENGINE


class CombineWithScene(Reporting, bpy.types.Operator):
    """Operator: the hands, rendered by JGHand, go into the picture of this scene's own engine, by depth."""

    bl_idname = "jghand.combine_with_scene"
    bl_label = "Set Up Compositing"
    bl_description = (
        "Give the hands a scene of their own that JGHand renders, and combine it with this one by depth in the "
        "compositor. Once more brings it up to date with this scene's hands, camera, size and frames. "
        "Locks the interface while rendering, because Blender can crash when a scene is edited meanwhile"
    )
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        scene = context.scene
        if composite.is_hands_scene(scene):
            return missing(cls, "This scene is there for the hands of another")
        if scene.render.engine == ENGINE:
            return missing(cls, "Choose Cycles or EEVEE first: this scene is rendered by JGHand alone")
        if scene.camera is None:
            return missing(cls, "The scene has no camera")
        if not armature.hands_at_any_frame(context.view_layer):
            return missing(cls, "There is no hand in this scene that is rendered")
        return True

    def run(self, context: bpy.types.Context) -> None:
        ours = composite.combine(context.scene, context.view_layer)
        self.tell(rpt_("The hands are rendered in the scene {name} and combined by depth.").format(name=ours.name))


class RemoveCombination(Reporting, bpy.types.Operator):
    """Operator: takes away what Set Up Compositing made."""

    bl_idname = "jghand.remove_combination"
    bl_label = "Remove Compositing"
    bl_description = "Take away the hands' own scene and the nodes that combine it; nodes of yours stay"
    bl_options = UNDOABLE

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        if not composite.has_combination(context.scene):
            return missing(cls, "This scene is not combined with hands")
        return True

    def run(self, context: bpy.types.Context) -> None:
        composite.remove(context.scene)
        self.tell(rpt_("This scene is not combined with hands any more."))


CLASSES = (CombineWithScene, RemoveCombination)
