# SPDX-License-Identifier: GPL-3.0-or-later
"""What the viewport and renders show."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as iface_

from .. import ui, versions
from ..core import panel_text
from ..ui import Sidebar
from ..viewport import views
from . import composite
from .engine_name import ENGINE


class ViewPanel(Sidebar, bpy.types.Panel):
    """View."""

    bl_idname = "VIEW3D_PT_jghand_view"
    bl_label = "View"
    bl_order = ui.VIEW

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.any_hand(context)

    def draw_header(self, context: bpy.types.Context) -> None:
        """All hands on and off."""
        self.layout.prop(context.scene.jghand, "show_in_viewport", text="")

    def draw(self, context: bpy.types.Context) -> None:
        layout, settings = self.layout, context.scene.jghand
        layout.active = settings.show_in_viewport
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(settings, "viewport_density", slider=True)
        late = views.late_frames()
        if late:
            text = iface_("Late: {count}").format(count=late)
            tip = iface_(
                "Frames of the last playback that were drawn before their picture came. A budget or density helps"
            )
            ui.explained(layout, panel_text.Line(text, tip=tip), icon="INFO")
        shading = getattr(context.space_data, "shading", None)
        text = _shading_hint(shading.type if shading is not None else "SOLID", context.scene.render.engine)
        if text:
            ui.paragraph(layout, context, text, icon="INFO")
        tip = iface_(
            "Blender's Viewport Render Image and Viewport Render Animation ask no extension, so hands are not in them. "
            "For a quick film, render the animation with the JGHand engine at the quality Draft or Viewport"
        )
        ui.explained(layout, panel_text.Line(iface_("Viewport Render leaves hands out"), tip=tip), icon="INFO")
        if versions.has_native_splats():
            text = iface_("This Blender has splat objects. JGHand does not make them of hands yet: it shows pictures")
            ui.paragraph(layout, context, text, icon="INFO")


class RenderPanel(Sidebar, bpy.types.Panel):
    """Render."""

    bl_idname = "VIEW3D_PT_jghand_render"
    bl_label = "Render"
    bl_order = ui.RENDER

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return ui.any_hand(context)

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        ours = scene.render.engine == ENGINE
        if not ours:
            row = layout.row()
            row.scale_y = 1.2
            row.operator("jghand.use_engine", icon="RESTRICT_RENDER_OFF")
        _draw_colors(layout, context)
        column = layout.column()
        column.use_property_split = True
        column.use_property_decorate = False
        column.prop(scene.jghand, "render_preset", text="Quality")
        column.prop(scene.render, "film_transparent")
        column.prop(scene.render, "use_motion_blur")
        if scene.render.use_motion_blur:
            column.prop(scene.jghand, "motion_samples")
            column.prop(scene.render, "motion_blur_shutter")
        column.prop(scene.jghand, "use_pass_ids")
        _draw_camera(layout, context)
        if not ours:
            layout.operator("jghand.combine_with_scene", icon="NODE_COMPOSITING")
            if composite.has_combination(scene):
                layout.operator("jghand.remove_combination", icon="X")


def _draw_colors(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    """What the scene's view transform does to the hand."""
    view = context.scene.view_settings
    if view.view_transform != "Standard":
        text = iface_("View transform is {name}: colors differ from the capture").format(name=view.view_transform)
    elif view.look != "None" or view.exposure != 0.0 or view.gamma != 1.0 or view.use_curve_mapping:
        text = iface_("Look, exposure, gamma or curves change the hand's colors")
    else:
        return
    column = layout.column()
    ui.paragraph(column, context, text, icon="INFO")
    column.operator("jghand.use_standard", icon="COLOR")


def _draw_camera(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    camera = context.scene.camera
    if camera is None:
        ui.paragraph(layout, context, "The scene has no camera", icon="ERROR")
    elif camera.type == "CAMERA" and camera.data.type == "PANO":
        ui.paragraph(layout, context, "Panoramic cameras are not supported", icon="ERROR")
    layout.operator("jghand.add_camera", icon="CAMERA_DATA")


def _shading_hint(shading: str, engine: str) -> str:
    """What a view shows that has no hands."""
    if shading == "WIREFRAME":
        return "Wireframe shows no hands: they are in Solid, Material Preview and Rendered"
    if shading == "RENDERED" and engine != ENGINE:
        return "Rendered mode shows hands with the JGHand engine only"
    return ""


CLASSES = (ViewPanel, RenderPanel)
