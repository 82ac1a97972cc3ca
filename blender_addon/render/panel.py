# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tab offers for pictures: an engine that draws hands, and a camera. Settings are in Render Properties."""

from __future__ import annotations

from typing import ClassVar

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui
from ..errors import JGHandFailure
from ..hand import avatar_files, seen_hands
from . import ENGINE, composite, limits, scene_light


class RenderPanel(ui.HandSidebar, bpy.types.Panel):
    bl_idname = "VIEW3D_PT_jghand_render"
    bl_label = "Render"
    bl_order = ui.RENDER

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        camera = scene.camera
        if camera is not None and camera.type == "CAMERA" and camera.data.type == "PANO":
            ui.paragraph(layout, context, "Panoramic cameras are not supported", icon="ERROR")
        for sentence in ui.kept(context, limits.sentences) or ():
            ui.paragraph(layout, context, sentence, icon="INFO")
        combined = composite.has_combination(scene)
        if scene.render.engine == ENGINE or combined:
            _draw_colors(layout, context)
        if scene.render.engine != ENGINE:
            layout.operator("jghand.use_engine", icon="RESTRICT_RENDER_OFF")
            layout.operator("jghand.combine_with_scene", icon="NODE_COMPOSITING")
            if combined:
                layout.operator("jghand.remove_combination", icon="X")
        layout.operator("jghand.add_camera", icon="CAMERA_DATA")


class LightPanel(ui.HandSidebar, bpy.types.Panel):
    """What lights hands, and whether they throw a shadow on the scene."""

    bl_idname = "VIEW3D_PT_jghand_light"
    bl_label = "Light"
    bl_parent_id = RenderPanel.bl_idname
    bl_options: ClassVar[set[str]] = {"DEFAULT_CLOSED"}

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        layout.row().prop(scene.jghand, "light", expand=True)
        _draw_kinds(layout, context)
        is_chosen = scene_light.is_chosen(scene)
        around = layout.column()
        around.active = is_chosen
        around.prop(scene.jghand, "use_surroundings")
        around.prop(scene.jghand, "use_exact_light")
        for warning in scene_light.warnings() if is_chosen else ():
            ui.paragraph(layout, context, warning, icon="INFO")
        hand = ui.active(context)
        if hand is not None and hand.type == "ARMATURE":
            layout.prop(hand.jghand, "cast_shadow")
        layout.operator("jghand.save_light", icon="FILE_TICK")


def _draw_kinds(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """How the hands answer the light of a scene; by their names, where they differ."""
    kinds: dict[str, list[str]] = {}
    for hand in ui.hands_of(context):
        try:
            text = iface_(avatar_files.card_of(seen_hands.avatar_of(hand)).in_scene_light)
        except JGHandFailure:  # told beside the hands
            continue
        kinds.setdefault(text, []).append(hand.name)
    for text, names in kinds.items():
        ui.paragraph(layout, context, text if len(kinds) == 1 else f"{', '.join(names)}: {text}", icon="LIGHT")


def _draw_colors(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What the scene's view transform does to the hand."""
    view = context.scene.view_settings
    if scene_light.is_chosen(context.scene):
        return
    if view.view_transform != "Standard":
        text = iface_("View transform is {name}: colors differ from the capture").format(name=view.view_transform)
    elif view.look != "None" or view.exposure != 0.0 or view.gamma != 1.0 or view.use_curve_mapping:
        text = iface_("Look, exposure, gamma or curves change the hand's colors")
    else:
        return
    column = layout.column()
    ui.paragraph(column, context, text, icon="INFO")
    column.operator("jghand.use_standard", icon="COLOR")


CLASSES = (RenderPanel, LightPanel)
