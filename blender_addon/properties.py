# SPDX-License-Identifier: GPL-3.0-or-later
"""What is saved with a .blend file: settings of each hand on its object, settings of pictures on the scene.

Being Blender's own properties they are saved, duplicated, appended, overridden and undone with their owner. Renaming
one orphans what older files hold: add a new name instead. Numbers of enum items are stored too, so they stand here.
"""

from __future__ import annotations

import bpy

from .core import limits, poses
from .core.joints import FINGERS, RIGHT
from .export import properties as output_settings
from .hand import sources
from .versions import path_options

# identifier, name, tooltip, icon, number in files
PRESETS = (
    ("draft", "Draft", "Fastest: fewer splats, no self-shadow", "NONE", 0),
    ("viewport", "Viewport", "Fast, with self-shadow where fingers are close", "NONE", 1),
    ("final", "Final", "What the avatar looks like, for renders", "NONE", 2),
    ("reference", "Reference", "Slow and exact, for comparisons", "NONE", 3),
)
HANDS = (
    ("right", "Right", "The right hand", "NONE", 0),
    ("left", "Left", "The left hand", "NONE", 1),
)
ENDS = (
    ("head", "Head", "The joint is where the bone begins", "NONE", 0),
    ("tail", "Tail", "The joint is where the bone ends: the tip of a finger that has no bone of its own", "NONE", 1),
)
# a hand that is linked from another file, and overridden, keeps settings of its own
OVERRIDABLE = {"LIBRARY_OVERRIDABLE"}
FINGER_ITEMS = tuple((name, name.capitalize(), f"The {name} finger", "NONE", at) for at, name in enumerate(FINGERS))

# the named poses; both hands have the same, and numbers are places in the table
POSES = tuple(
    (
        pose.name,
        pose.title.partition(" (")[0],
        pose.description or f"A hand pose: {pose.name.replace('_', ' ')}",
        "NONE",
        place,
    )
    for place, pose in enumerate(poses.all_poses(RIGHT))
)


# properties' functions have names of their own: a lambda in an annotation would not see this module
def _bone(row: JGHandJoint) -> str:
    return sources.bone_of(row.id_data, row.name)


def _set_bone(row: JGHandJoint, bone: str) -> None:
    sources.set_bone(row.id_data, row.name, bone)


def _end(row: JGHandJoint) -> int:
    return sources.end_of(row.id_data, row.name)


def _set_end(row: JGHandJoint, place: int) -> None:
    sources.set_end(row.id_data, row.name, place)


def _evaluate_again(settings: JGHandObjectSettings, _context: bpy.types.Context) -> None:
    """Renders read what Blender evaluated, and keep it where the scene has Persistent Data."""
    settings.id_data.update_tag()


class JGHandJoint(bpy.types.PropertyGroup):
    """One row of a foreign armature's bone map: `name` is the joint, the rest is read from the stored map."""

    bone: bpy.props.StringProperty(
        name="Bone",
        description="The bone of the rig that begins or ends at this joint",
        get=_bone,
        set=_set_bone,
    )  # type: ignore[valid-type]
    end: bpy.props.EnumProperty(
        name="End",
        description="Which end of the bone the joint is",
        items=ENDS,
        get=_end,
        set=_set_end,
    )  # type: ignore[valid-type]


class JGHandObjectSettings(bpy.types.PropertyGroup):
    """`object.jghand` of an armature, or of an empty that stands for 21 objects, that is a hand."""

    avatar: bpy.props.StringProperty(
        name="Avatar",
        description="File of the avatar that is drawn on this hand. Empty: the one that comes with JGHand",
        subtype="FILE_PATH",
        update=_evaluate_again,
        options=path_options(),
        override=OVERRIDABLE,
    )  # type: ignore[valid-type]
    show_in_viewport: bpy.props.BoolProperty(
        name="Show in Viewport",
        description="Draw the avatar of this hand in Solid and Material Preview",
        default=True,
        override=OVERRIDABLE,
    )  # type: ignore[valid-type]
    bake: bpy.props.StringProperty(
        name="Bake",
        description="Folder of this hand's bake. Empty: it was not baked",
        subtype="DIR_PATH",
        options=path_options(),
        override=OVERRIDABLE,
    )  # type: ignore[valid-type]
    map_hand: bpy.props.EnumProperty(
        name="Hand",
        description="Whose bones the list shows",
        items=HANDS,
        default="right",
        override=OVERRIDABLE,
    )  # type: ignore[valid-type]
    joints: bpy.props.CollectionProperty(type=JGHandJoint)  # type: ignore[valid-type]
    active_joint: bpy.props.IntProperty(name="Joint", description="The joint that is selected in the list")  # type: ignore[valid-type]


class JGHandSceneSettings(bpy.types.PropertyGroup):
    """`scene.jghand`: how pictures of this scene are made, and what is written of it."""

    output: bpy.props.PointerProperty(type=output_settings.JGHandOutputSettings)  # type: ignore[valid-type]
    training: bpy.props.PointerProperty(type=output_settings.JGHandTrainingSettings)  # type: ignore[valid-type]

    show_in_viewport: bpy.props.BoolProperty(
        name="Show Hands",
        description="Draw the avatars in Solid and Material Preview",
        default=True,
    )  # type: ignore[valid-type]
    viewport_preset: bpy.props.EnumProperty(
        name="Viewport Quality",
        description="How the viewport is drawn while nothing moves",
        items=PRESETS,
        default="viewport",
    )  # type: ignore[valid-type]
    sharpen_when_still: bpy.props.BoolProperty(
        name="Sharpen When Still",
        description="After a pause, draw the viewport with the settings of renders",
        default=True,
    )  # type: ignore[valid-type]
    use_viewport_budget: bpy.props.BoolProperty(
        name="Frame Budget",
        description="Choose the most accurate measured settings that draw a viewport frame in the given time",
    )  # type: ignore[valid-type]
    viewport_budget_ms: bpy.props.FloatProperty(
        name="Milliseconds",
        description="Time that the renderer may take for a viewport frame, in milliseconds",
        default=limits.BUDGET_MS,
        min=1.0,
        soft_max=100.0,
        precision=1,
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
    shadow_radius_mm: bpy.props.FloatProperty(
        name="Shadow Radius",
        description="How far a shadow reaches from what casts it, in the size of a real hand",
        unit="CAMERA",  # millimeters whatever the scene's unit is: a hand is as large in all of them
        default=limits.SHADOW_RADIUS_MM,
        min=1.0,
        max=limits.SHADOW_RADIUS_MAX_MM,
        soft_max=60.0,
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


_OWNERS = (
    (bpy.types.Object, JGHandObjectSettings),
    (bpy.types.Scene, JGHandSceneSettings),
)
CLASSES = (JGHandJoint, *output_settings.CLASSES, *(settings for _, settings in _OWNERS))


def register() -> None:
    """Adds `object.jghand` and `scene.jghand`."""
    for owner, settings in _OWNERS:
        owner.jghand = bpy.props.PointerProperty(type=settings, override=OVERRIDABLE)


def unregister() -> None:
    """Takes them away; what files hold stays in them."""
    for owner, _ in reversed(_OWNERS):
        if hasattr(owner, "jghand"):
            del owner.jghand
