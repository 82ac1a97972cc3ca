# SPDX-License-Identifier: GPL-3.0-or-later
"""What is saved with a .blend file: settings of each hand on its object, settings of pictures on the scene.

Being Blender's own properties they are saved, duplicated, appended, overridden and undone with their owner. Renaming
one orphans what older files hold: add a new name instead. Numbers of enum items are stored too, so they stand here.
"""

from __future__ import annotations

import bpy

from .bridge.classes import register_classes, unregister_classes
from .core import limits

# identifier, name, tooltip, icon, number in files
PRESETS = (
    ("draft", "Draft", "Fastest: fewer splats, no self-shadow", "NONE", 0),
    ("viewport", "Viewport", "Fast, with self-shadow where fingers are close", "NONE", 1),
    ("final", "Final", "What the avatar looks like, for renders", "NONE", 2),
    ("reference", "Reference", "Slow and exact, for comparisons", "NONE", 3),
)


class JGHandObjectSettings(bpy.types.PropertyGroup):
    """`object.jghand` of an armature, or of an empty that stands for 21 objects, that is a hand."""

    avatar: bpy.props.StringProperty(
        name="Avatar",
        description="File of the avatar that is drawn on this hand. Empty: the one that comes with JGHand",
        subtype="FILE_PATH",
    )  # type: ignore[valid-type]
    show_in_viewport: bpy.props.BoolProperty(
        name="Show in Viewport",
        description="Draw the avatar of this hand in Solid and Material Preview",
        default=True,
    )  # type: ignore[valid-type]


class JGHandSceneSettings(bpy.types.PropertyGroup):
    """`scene.jghand`: how pictures of this scene are made."""

    show_in_viewport: bpy.props.BoolProperty(
        name="Show Hands",
        description="Draw the avatars in Solid and Material Preview",
        default=True,
    )  # type: ignore[valid-type]
    viewport_preset: bpy.props.EnumProperty(
        name="Viewport Quality",
        description="How pictures in the viewport are made while nothing moves",
        items=PRESETS,
        default="viewport",
    )  # type: ignore[valid-type]
    use_viewport_budget: bpy.props.BoolProperty(
        name="Frame Budget",
        description="Choose the most accurate measured settings that draw a viewport picture in the given time",
    )  # type: ignore[valid-type]
    viewport_budget_ms: bpy.props.FloatProperty(
        name="Milliseconds",
        description="Time that one viewport picture may take in the engine, in milliseconds",
        default=limits.BUDGET_MS,
        min=1.0,
        soft_max=100.0,
    )  # type: ignore[valid-type]
    viewport_density: bpy.props.FloatProperty(
        name="Density",
        description="Part of the avatar's splats that the viewport draws",
        subtype="FACTOR",
        default=1.0,
        min=limits.DENSITY_MIN,
        max=1.0,
    )  # type: ignore[valid-type]
    render_preset: bpy.props.EnumProperty(
        name="Render Quality",
        description="How F12 and animation renders are made",
        items=PRESETS,
        default="final",
    )  # type: ignore[valid-type]
    shadow_strength: bpy.props.FloatProperty(
        name="Shadow Strength",
        description="How dark the shadow is that a hand casts on itself and on the other",
        subtype="FACTOR",
        default=1.0,
        min=0.0,
        max=1.0,
    )  # type: ignore[valid-type]
    motion_samples: bpy.props.IntProperty(
        name="Motion Samples",
        description="Sub-frames that are averaged when the scene uses motion blur",
        default=limits.MOTION_SAMPLES,
        min=2,
        soft_max=32,
        max=limits.MOTION_SAMPLES_MAX,
    )  # type: ignore[valid-type]
    use_pass_ids: bpy.props.BoolProperty(
        name="Bone Ids",
        description="Add a pass with the number of the bone that a pixel belongs to, 0 where there is no hand",
    )  # type: ignore[valid-type]


_CLASSES = (JGHandObjectSettings, JGHandSceneSettings)


def register() -> None:
    """Adds `object.jghand` and `scene.jghand`."""
    register_classes(_CLASSES)
    bpy.types.Object.jghand = bpy.props.PointerProperty(type=JGHandObjectSettings)
    bpy.types.Scene.jghand = bpy.props.PointerProperty(type=JGHandSceneSettings)


def unregister() -> None:
    """Takes them away; what files hold stays in them."""
    for owner in (bpy.types.Scene, bpy.types.Object):
        if hasattr(owner, "jghand"):
            del owner.jghand
    unregister_classes(_CLASSES)
