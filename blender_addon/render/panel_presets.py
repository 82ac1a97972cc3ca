# SPDX-License-Identifier: GPL-3.0-or-later
"""Presets of picture settings, as Blender has them beside its own: kept with the user's, for all files."""

from __future__ import annotations

import bpy
from bl_operators.presets import AddPresetBase
from bl_ui.utils import PresetPanel

from ..ops import PLUMBING

SETTINGS = (
    *("render_preset", "shadow_strength", "shadow_radius_mm", "motion_samples"),
    *("viewport_preset", "sharpen_when_still", "use_viewport_budget", "viewport_budget_ms", "viewport_density"),
)
FOLDER = "jghand/pictures"


class RENDER_PT_jghand_presets(PresetPanel, bpy.types.Panel):  # noqa: N801 - Blender finds it by this name
    """The list of presets, with a field to add one."""

    bl_label = "JGHand Presets"
    preset_subdir = FOLDER
    preset_operator = "script.execute_preset"
    preset_add_operator = "jghand.add_picture_preset"


class AddPicturePreset(AddPresetBase, bpy.types.Operator):
    """Operator: the settings of now under a name, or one of them removed."""

    bl_idname = "jghand.add_picture_preset"
    bl_label = "Add JGHand Preset"
    bl_description = "Keep quality, shadow and speed of hands in the viewport and in renders under a name"
    bl_options = PLUMBING

    preset_menu = RENDER_PT_jghand_presets.__name__
    preset_subdir = FOLDER
    preset_defines = ["settings = bpy.context.scene.jghand"]  # noqa: RUF012 - Blender's own name and type
    preset_values = [f"settings.{name}" for name in SETTINGS]  # noqa: RUF012 - Blender's own name and type


CLASSES = (RENDER_PT_jghand_presets, AddPicturePreset)
