# SPDX-License-Identifier: GPL-3.0-or-later
"""What differs between Blender versions. Features are looked for; version numbers are never compared."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import bpy
from bpy_extras import anim_utils


def new_action(owner: bpy.types.ID, name: str) -> bpy.types.Action:
    """A fresh action with a slot for `owner`, made its active one. The action before it stays in the file, also when
    that is saved."""
    action = bpy.data.actions.new(name)
    slot = action.slots.new(owner.id_type, owner.name)
    animation = owner.animation_data or owner.animation_data_create()
    if animation.action is not None and animation.action.library is None:
        animation.action.use_fake_user = True
    animation.action = action
    animation.action_slot = slot
    return action


def new_fcurve(owner: bpy.types.ID, data_path: str, index: int, group: str) -> bpy.types.FCurve:
    """A curve in the action of `owner` made by `new_action`, in the named group."""
    animation = owner.animation_data
    if hasattr(anim_utils, "action_ensure_channelbag_for_slot"):  # 5.0 and later
        bag = anim_utils.action_ensure_channelbag_for_slot(animation.action, animation.action_slot)
        curve = bag.fcurves.new(data_path, index=index)
        curve.group = bag.groups.get(group) or bag.groups.new(group)
        return curve
    curve = animation.action.fcurve_ensure_for_datablock(owner, data_path, index=index)  # 4.5
    bag = anim_utils.action_get_channelbag_for_slot(animation.action, animation.action_slot)
    curve.group = bag.groups.get(group) or bag.groups.new(group)
    return curve


def fcurves(owner: bpy.types.ID) -> list[Any]:
    """All curves of the owner's active action."""
    animation = owner.animation_data
    if animation is None or animation.action is None:
        return []
    bag = anim_utils.action_get_channelbag_for_slot(animation.action, animation.action_slot)
    return list(bag.fcurves) if bag else []


def still_action(name: str, curves: Iterable[tuple[str, int, float, str]]) -> bpy.types.Action:
    """An action for objects with one key, at frame 1, per curve (data path, index, value, group)."""
    action = bpy.data.actions.new(name)
    slot = action.slots.new("OBJECT", "Hand")
    strip = action.layers.new("Layer").strips.new(type="KEYFRAME")
    bag = strip.channelbag(slot, ensure=True)
    for data_path, index, value, group in curves:
        curve = bag.fcurves.new(data_path, index=index)
        curve.group = bag.groups.get(group) or bag.groups.new(group)
        curve.keyframe_points.insert(1.0, value)
    return action


def has_native_splats() -> bool:
    """Whether this Blender draws Gaussian splats itself."""
    kind = bpy.types.PointCloud.bl_rna.properties.get("type")
    return kind is not None and "GAUSSIAN_SPLAT" in getattr(kind, "enum_items", ())


def write_png(settings: bpy.types.ImageFormatSettings) -> None:
    """Makes a scene write PNG; where it does already, its depth, colours and compression stay."""
    if hasattr(settings, "media_type"):  # 5.0 and later; which formats there are depends on it
        settings.media_type = "IMAGE"
    if settings.file_format != "PNG":
        settings.file_format, settings.color_mode, settings.color_depth = "PNG", "RGBA", "8"


def path_options(*more: str) -> set[str]:
    """Options of a property that is a path and may begin with `//`; 4.5 takes that for granted where it knows no
    option for it."""
    known = "is_path_supports_blend_relative" in bpy.types.StringProperty.bl_rna.properties
    return {*more, *({"PATH_SUPPORTS_BLEND_RELATIVE"} if known else ())}
