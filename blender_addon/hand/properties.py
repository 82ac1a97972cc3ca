# SPDX-License-Identifier: GPL-3.0-or-later
"""What is saved with a hand: `object.jghand`, and the rows of a foreign armature's bone map; and which hands Add Hand
offers by picture: those that come with JGHand, and those of packs that were installed.

Being Blender's own properties they are saved, duplicated, appended, overridden and undone with their owner. Renaming
one orphans what older files hold: add a new name instead. Numbers of enum items are stored too, so they stand here.
"""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews

from ..core import bone_maps, poses
from ..core.bone_maps import JointSource
from ..core.joints import FINGERS
from ..core.view import BUILTIN_AVATAR
from ..versions import path_options
from . import avatar_files, controls, seen_hands, sources, stand_ins

# identifier, name, tooltip, icon, number in files
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

# the named poses; both hands have the same, and numbers are places in the list
POSES = tuple(
    (pose.name, pose.label, pose.description or f"A hand pose: {pose.name.replace('_', ' ')}", "NONE", place)
    for place, pose in enumerate(poses.ALL_POSES)
)


# properties' functions have names of their own: a lambda in an annotation would not see this module
def _bone(row: JGHandJoint) -> str:
    return sources.source_of(row.id_data, row.name).bone


def _set_bone(row: JGHandJoint, bone: str) -> None:
    end = sources.source_of(row.id_data, row.name).end
    sources.set_source(row.id_data, row.name, JointSource(bone, end) if bone else None)


def _end(row: JGHandJoint) -> int:
    return bone_maps.ENDS.index(sources.source_of(row.id_data, row.name).end)


def _set_end(row: JGHandJoint, place: int) -> None:
    if bone := sources.source_of(row.id_data, row.name).bone:
        sources.set_source(row.id_data, row.name, JointSource(bone, bone_maps.ENDS[place]))


def _evaluate_again(settings: JGHandObjectSettings, _context: bpy.types.Context) -> None:
    """Renders read what Blender evaluated, and keep it where the scene has Persistent Data."""
    settings.id_data.update_tag()


def _make_anew(settings: JGHandObjectSettings, context: bpy.types.Context) -> None:
    """... and what throws the shadow."""
    _evaluate_again(settings, context)
    stand_ins.update()


def _show_avatar(settings: JGHandObjectSettings, context: bpy.types.Context) -> None:
    """... and the fist that the finger controls close is the avatar's."""
    _evaluate_again(settings, context)
    hand = settings.id_data
    if controls.may_use_fist(hand):
        controls.use_fist(hand, avatar_files.fist_of(seen_hands.avatar_of(hand)))


class JGHandJoint(bpy.types.PropertyGroup):
    """One row of a foreign armature's bone map: `name` is the joint, the rest is read from the stored map."""

    bone: bpy.props.StringProperty(
        name="Bone",
        description="The bone of the rig that begins or ends at this joint",
        get=_bone,
        set=_set_bone,
    )
    end: bpy.props.EnumProperty(
        name="End",
        description="Which end of the bone the joint is",
        items=ENDS,
        get=_end,
        set=_set_end,
    )


class JGHandObjectSettings(bpy.types.PropertyGroup):
    """`object.jghand` of an armature, or of an empty that stands for 21 objects, that is a hand."""

    avatar: bpy.props.StringProperty(
        name="Avatar",
        description="File of the avatar that is drawn on this hand. Empty: the one that comes with JGHand",
        subtype="FILE_PATH",
        update=_show_avatar,
        options=path_options(),
        override=OVERRIDABLE,
    )
    show_in_viewport: bpy.props.BoolProperty(
        name="Show in Viewport",
        description="Draw the avatar of this hand in Solid and Material Preview",
        default=True,
        override=OVERRIDABLE,
    )
    forearm: bpy.props.BoolProperty(
        name="Forearm",
        description="Show the forearm, of an avatar that has one. Without it the hand fades out at the wrist",
        default=True,
        update=_make_anew,
        override=OVERRIDABLE,
    )
    cast_shadow: bpy.props.BoolProperty(
        name="Cast Shadow",
        description="Throw a shadow on the scene in Cycles and EEVEE, by a mesh that no camera sees",
        default=True,
        update=_make_anew,
        options=set(),
        override=OVERRIDABLE,
    )
    bake: bpy.props.StringProperty(
        name="Bake",
        description="Folder of this hand's bake. Empty: it was not baked",
        subtype="DIR_PATH",
        options=path_options(),
        override=OVERRIDABLE,
    )
    map_hand: bpy.props.EnumProperty(
        name="Hand",
        description="Whose bones the list shows",
        items=HANDS,
        default="right",
        override=OVERRIDABLE,
    )
    joints: bpy.props.CollectionProperty(type=JGHandJoint)
    active_joint: bpy.props.IntProperty(name="Joint", description="The joint that is selected in the list")


# ---- the hands that are offered --------------------------------------------------------------------------------------

# Blender keeps no texts of dynamic items, nor their pictures
_Items = list[tuple[str, str, str, int, int]]
_items: _Items = []
_pictures: list[bpy.utils.previews.ImagePreviewCollection] = []


def hand_items(_owner: object = None, _context: bpy.types.Context | None = None) -> _Items:
    """Of an enumeration: the built-in hand, then the others. Their numbers hold until hands are installed."""
    found = [(BUILTIN_AVATAR, "Built-in", "The hand that comes with JGHand", icon_of(_picture_of(BUILTIN_AVATAR)), 0)]
    for place, hand in enumerate(avatar_files.hands_in(seen_hands.hand_folders()), 1):
        found.append((hand.name, hand.title, str(hand.file), icon_of(hand.picture), place))
    if found != _items:
        _items[:] = found
    return _items


def _picture_of(name: str) -> Path | None:
    paths = (folder / f"{name}{avatar_files.PICTURE}" for folder in seen_hands.hand_folders())
    return next((path for path in paths if path.is_file()), None)


def icon_of(picture: Path | None) -> int:
    """Of a picture as its file is now; 0 for none."""
    if picture is None or not picture.is_file():
        return 0
    if not _pictures:
        _pictures.append(bpy.utils.previews.new())
    (loaded,) = _pictures
    key = f"{picture} {picture.stat().st_mtime_ns}"
    return (loaded[key] if key in loaded else loaded.load(key, str(picture), "IMAGE")).icon_id


class JGHandChoice(bpy.types.PropertyGroup):
    """`window_manager.jghand`: what Add Hand adds next; not saved with the file."""

    hand: bpy.props.EnumProperty(name="Hand", description="The hand that Add Hand adds", items=hand_items)


CLASSES = (JGHandJoint, JGHandObjectSettings, JGHandChoice)
SETTINGS = ((bpy.types.Object, JGHandObjectSettings), (bpy.types.WindowManager, JGHandChoice))


def unregister() -> None:
    while _pictures:
        bpy.utils.previews.remove(_pictures.pop())
