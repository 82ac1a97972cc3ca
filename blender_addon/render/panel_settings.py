# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine's own pages in the Properties editor: quality, film and motion blur, passes."""

from __future__ import annotations

import bpy

from .engine_name import ENGINE
from .panel_presets import RENDER_PT_jghand_presets


class _EnginesPage:
    """A panel that shows while the scene is rendered by JGHand."""

    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    COMPAT_ENGINES = {ENGINE}  # noqa: RUF012 - Blender's own name and type

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        return context.engine in cls.COMPAT_ENGINES

    def column(self) -> bpy.types.UILayout:
        """Where properties go."""
        self.layout.use_property_split = True
        self.layout.use_property_decorate = False
        return self.layout.column()


class QualityPage(_EnginesPage, bpy.types.Panel):
    """Quality."""

    bl_idname = "RENDER_PT_jghand_quality"
    bl_label = "Quality"

    def draw_header_preset(self, _context: bpy.types.Context) -> None:
        """Presets."""
        RENDER_PT_jghand_presets.draw_panel_header(self.layout)

    def draw(self, context: bpy.types.Context) -> None:
        column, settings = self.column(), context.scene.jghand
        column.prop(settings, "render_preset")
        column.prop(settings, "shadow_strength", slider=True)
        column.prop(settings, "shadow_radius_mm")


class MotionBlurPage(_EnginesPage, bpy.types.Panel):
    """Motion blur."""

    bl_idname = "RENDER_PT_jghand_motion_blur"
    bl_label = "Motion Blur"
    bl_options = {"DEFAULT_CLOSED"}  # noqa: RUF012 - Blender's own name and type

    def draw_header(self, context: bpy.types.Context) -> None:
        """On and off."""
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: bpy.types.Context) -> None:
        column, scene = self.column(), context.scene
        column.active = scene.render.use_motion_blur
        column.prop(scene.render, "motion_blur_position", text="Position")
        column.prop(scene.render, "motion_blur_shutter")
        column.prop(scene.jghand, "motion_samples")
        column.template_curve_mapping(scene.render, "motion_blur_shutter_curve")


class FilmPage(_EnginesPage, bpy.types.Panel):
    """Film."""

    bl_idname = "RENDER_PT_jghand_film"
    bl_label = "Film"

    def draw(self, context: bpy.types.Context) -> None:
        self.column().prop(context.scene.render, "film_transparent", text="Transparent")


class PassesPage(_EnginesPage, bpy.types.Panel):
    """Passes."""

    bl_idname = "VIEWLAYER_PT_jghand_passes"
    bl_label = "Passes"
    bl_context = "view_layer"

    def draw(self, context: bpy.types.Context) -> None:
        column = self.column()
        column.prop(context.view_layer, "use_pass_z", text="Depth")
        column.prop(context.scene.jghand, "use_pass_ids")


CLASSES = (QualityPage, FilmPage, MotionBlurPage, PassesPage)
