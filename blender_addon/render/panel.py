# SPDX-License-Identifier: GPL-3.0-or-later
"""What the tab offers for pictures, an engine that draws hands and a camera; their settings in Render Properties."""

from __future__ import annotations

import bpy

from .. import ui
from ..core import panel_text
from ..errors import JGHandFailure
from ..hand import avatar_files, seen_hands
from ..renderer import runtime
from ..viewport import views
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
    bl_idname = "VIEW3D_PT_jghand_light"
    bl_label = "Light"
    bl_parent_id = RenderPanel.bl_idname
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        layout, scene = self.layout, context.scene
        layout.row().prop(scene.jghand, "light", expand=True)
        _draw_kinds(layout, context)
        is_chosen = scene_light.is_chosen(scene)
        around = layout.column()
        around.active = is_chosen
        around.prop(scene.jghand, "use_surroundings")
        around.prop(scene.jghand, "use_exact_light")
        for warning in scene_light.warnings if is_chosen else ():
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
            text = avatar_files.card_of(seen_hands.avatar_of(hand)).in_scene_light
        except JGHandFailure:  # told beside the hands
            continue
        kinds.setdefault(text, []).append(hand.name)
    for text, names in kinds.items():
        ui.paragraph(layout, context, text if len(kinds) == 1 else f"{', '.join(names)}: {text}", icon="LIGHT")


def _draw_colors(layout: bpy.types.UILayout, context: bpy.types.Context) -> None:
    view = context.scene.view_settings
    if scene_light.is_chosen(context.scene):
        return
    if view.view_transform != "Standard":
        text = f"View transform is {view.view_transform}: colors differ from the capture"
    elif view.look != "None" or view.exposure != 0.0 or view.gamma != 1.0 or view.use_curve_mapping:
        text = "Look, exposure, gamma or curves change the hand's colors"
    else:
        return
    column = layout.column()
    ui.paragraph(column, context, text, icon="INFO")
    column.operator("jghand.use_standard", icon="COLOR")


# ---- Render Properties -----------------------------------------------------------------------------------------------
# as Cycles has its own. Quality counts in every scene with hands, for the viewport and the compositor draw them with
# other engines too; film, motion blur and passes are Blender's own there


class _Page:
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"


class _OwnPage(_Page):
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - Blender's own name and type

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine in cls.COMPAT_ENGINES


class QualityPage(_Page, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_quality"
    bl_label = "Hands"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.scene.render.engine == ENGINE or ui.any_hand(context)

    def draw(self, _context: bpy.types.Context) -> None:
        pass


class ViewportPage(_Page, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_viewport"
    bl_label = "Viewport"
    bl_parent_id = QualityPage.bl_idname

    def draw(self, context: bpy.types.Context) -> None:
        column, settings = ui.settings(self.layout), context.scene.jghand
        column.prop(settings, "show_in_viewport")
        column = column.column()
        column.active = settings.show_in_viewport
        row = column.row(align=True, heading="Frame Budget")
        row.prop(settings, "use_viewport_budget", text="")
        budget = row.row(align=True)
        budget.active = settings.use_viewport_budget
        budget.prop(settings, "viewport_budget_ms", text="ms")
        preset = column.row()
        preset.active = not settings.use_viewport_budget
        preset.prop(settings, "viewport_preset", text="Quality")
        column.prop(settings, "sharpen_when_still")


class RenderPage(_Page, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_render"
    bl_label = "Render"
    bl_parent_id = QualityPage.bl_idname

    def draw(self, context: bpy.types.Context) -> None:
        column, settings = ui.settings(self.layout), context.scene.jghand
        column.prop(settings, "render_preset", text="Quality")
        column.prop(settings, "motion_samples")


class StatisticsPage(_Page, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_statistics"
    bl_label = "Statistics"
    bl_parent_id = QualityPage.bl_idname
    bl_options = ui.CLOSED

    def draw(self, context: bpy.types.Context) -> None:
        dropped = views.late_frames()
        if dropped:
            text = f"Dropped frames: {dropped}"
            tip = "Frames of the last playback that were drawn before their image came"
            ui.explained(self.layout, panel_text.Line(text, tip=tip), icon="INFO")
        settings = context.scene.jghand
        budget_ms = settings.viewport_budget_ms if settings.use_viewport_budget else None
        for kind, title, of_it_ms in ((runtime.VIEWPORT, "Viewport", budget_ms), (runtime.RENDER, "Render", None)):
            if (report := runtime.reports.get(kind)) is None:
                continue
            self.layout.label(text=title)
            for line in panel_text.warnings(report):
                ui.explained(self.layout, line, icon="ERROR")
            column = self.layout.column(align=True)
            for line in panel_text.receipt_lines(report, of_it_ms):
                ui.figure(column, line)


class FilmPage(_OwnPage, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_film"
    bl_label = "Film"

    def draw(self, context: bpy.types.Context) -> None:
        ui.settings(self.layout).prop(context.scene.render, "film_transparent", text="Transparent")


class MotionBlurPage(_OwnPage, bpy.types.Panel):
    bl_idname = "RENDER_PT_jghand_motion_blur"
    bl_label = "Motion Blur"
    bl_options = ui.CLOSED

    def draw_header(self, context: bpy.types.Context) -> None:
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        column, render = ui.settings(self.layout), context.scene.render
        column.active = render.use_motion_blur
        column.prop(render, "motion_blur_position", text="Position")
        column.prop(render, "motion_blur_shutter")
        column.template_curve_mapping(render, "motion_blur_shutter_curve")


class PassesPage(_OwnPage, bpy.types.Panel):
    bl_idname = "VIEWLAYER_PT_jghand_passes"
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        column = ui.settings(self.layout)
        column.prop(context.view_layer, "use_pass_z", text="Depth")
        column.prop(context.scene.jghand, "use_pass_ids")


CLASSES = (
    *(RenderPanel, LightPanel),
    *(QualityPage, ViewportPage, RenderPage, StatisticsPage, FilmPage, MotionBlurPage, PassesPage),
)
