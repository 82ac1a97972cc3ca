# SPDX-License-Identifier: GPL-3.0-or-later
"""What pictures need of a scene: the engine, the view transform, a camera; and the small print of panels."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy_extras.io_utils import ExportHelper

from .. import versions
from ..errors import JGHandFailure
from ..hand import armature, seen_hands
from ..hand.ops import add_camera
from ..ops import PLUMBING, REGISTERED, Reporting, missing
from . import ENGINE, composite, limits, scene_light


class UseEngine(Reporting, bpy.types.Operator):
    bl_idname = "jghand.use_engine"
    bl_label = "Use JGHand Engine"
    bl_description = (
        "Render the hands of this scene, and nothing else, with JGHand: F12, animations and Rendered shading. For "
        "images of all else, too, use Set Up Compositing. Locks the interface while rendering, since Blender can crash "
        "when a scene is edited meanwhile"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine != ENGINE or missing(cls, "This scene uses the JGHand engine already")

    def run(self, context: bpy.types.Context) -> None:
        context.scene.render.engine = ENGINE
        context.scene.render.use_lock_interface = True
        hands = armature.hands_at_any_frame(context.view_layer)
        doubts = limits.left_out(context.view_layer)
        if context.scene.camera is None and hands:
            camera = add_camera(context, hands[0])
            self.tell(f"The scene had no camera: {camera.name} shows the hand.", doubts=doubts)
        else:
            self.warn(*doubts)


def has_standard(view: bpy.types.ColorManagedViewSettings) -> bool:
    """Whether a scene's OCIO configuration has the view transform Standard for its display."""
    return bool(bpy.types.UILayout.enum_item_name(view, "view_transform", "Standard"))


def use_standard(view: bpy.types.ColorManagedViewSettings) -> None:
    """Colors as they were captured, where `has_standard`."""
    view.view_transform, view.look = "Standard", "None"
    view.exposure, view.gamma = 0.0, 1.0
    view.use_curve_mapping = False


class UseStandard(Reporting, bpy.types.Operator):
    bl_idname = "jghand.use_standard"
    bl_label = "Set Standard View Transform"
    bl_description = (
        "Set this scene's view transform to Standard, without look, exposure and gamma: the hand then has the colors "
        "of its capture. AgX and Filmic are made for light, and the hand is a photograph already"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        text = "The color management (OCIO) in use has no view transform Standard"
        return has_standard(context.scene.view_settings) or missing(cls, text)

    def run(self, context: bpy.types.Context) -> None:
        use_standard(context.scene.view_settings)


class AddCamera(Reporting, bpy.types.Operator):
    bl_idname = "jghand.add_camera"
    bl_label = "Add Hand Camera"
    bl_description = "Add a camera that shows the active hand as it is now, and make it the scene's camera"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        thing = context.object
        return (thing is not None and armature.is_any_hand(thing)) or missing(cls, "Select a hand")

    def run(self, context: bpy.types.Context) -> None:
        self.tell(f"Added {add_camera(context, context.object).name}.")


class Explain(bpy.types.Operator):
    bl_idname = "jghand.explain"
    bl_label = "Explain"
    bl_description = "Say why"
    bl_options = PLUMBING

    text: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"})

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        return properties.text

    def execute(self, _context: bpy.types.Context) -> set[str]:
        self.report({"INFO"}, self.text)
        return {"FINISHED"}


class CombineWithScene(Reporting, bpy.types.Operator):
    bl_idname = "jghand.combine_with_scene"
    bl_label = "Set Up Compositing"
    bl_description = (
        "Give the hands a scene of their own that JGHand renders, and combine it by depth in the compositor with this "
        "one, which Cycles or EEVEE renders. Once more brings it up to date with this scene's hands, camera, size and "
        "frames. Locks the interface while rendering, because Blender can crash when a scene is edited meanwhile"
    )

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        scene = context.scene
        if composite.is_hands_scene(scene):
            return missing(cls, "This scene is there for the hands of another")
        if scene.camera is None:
            return missing(cls, "The scene has no camera")
        if not seen_hands.sources_at_any_frame(context.view_layer):
            return missing(cls, "There is no hand in this scene that is rendered")
        return True

    def run(self, context: bpy.types.Context) -> None:
        scene = context.scene
        ours = composite.combine(scene, context.view_layer)
        said = [f"The hands are rendered in the scene {ours.name} and combined by depth."]
        if scene.render.engine == ENGINE:
            versions.use_eevee(scene)
            scene[composite.GIVEN_ENGINE] = scene.render.engine
            said.append("This scene is rendered by EEVEE now.")
        self.tell(*said)


class RemoveCombination(Reporting, bpy.types.Operator):
    bl_idname = "jghand.remove_combination"
    bl_label = "Remove Compositing"
    bl_description = "Take away the hands' own scene and the nodes that combine it; nodes of yours stay"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return composite.has_combination(context.scene) or missing(cls, "This scene is not combined with hands")

    def run(self, context: bpy.types.Context) -> None:
        composite.remove(context.scene)
        ours = context.scene.render.engine == ENGINE
        self.tell("This scene is not combined with hands any more.", "JGHand renders it." if ours else "")


class SaveLight(Reporting, ExportHelper, bpy.types.Operator):
    bl_idname = "jghand.save_light"
    bl_label = "Save Light"
    bl_description = "Write the lamps and the world of this scene, as they light hands, for renders outside Blender"
    bl_options = REGISTERED

    filename_ext = ".json"
    filter_glob: bpy.props.StringProperty(default="*.json", options={"HIDDEN"})

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        text = "Hands are in the light of their captures: choose Scene first"
        return scene_light.is_chosen(context.scene) or missing(cls, text)

    def run(self, context: bpy.types.Context) -> None:
        if not self.filepath:
            raise JGHandFailure("no_place")
        path = Path(bpy.path.abspath(self.filepath)).with_suffix(".json")
        scene_light.save(context.evaluated_depsgraph_get(), path)
        self.tell(f"Wrote {path}.", *scene_light.warnings)


CLASSES = (UseEngine, UseStandard, AddCamera, CombineWithScene, RemoveCombination, SaveLight, Explain)
