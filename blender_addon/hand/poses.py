# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole poses of our armature: taking one, taking the other hand's, going back to rest, keying what was posed; and
Blender's own asset shelf of them.

Turns (w, x, y, z) and ways (x, y, z) of bones are (w, x, -y, -z) and (-x, y, z) on the other hand, whose bones have
mirrored axes (`core.posing`); turns of the controls are the same on both.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import bpy
from mathutils import Quaternion, Vector

from .. import clock, ui, versions
from ..core import controls as control_numbers
from ..core.controls import CONTROLS, HAND_CONTROL
from ..core.joints import FINGERS, NAMES, WRIST
from ..core.poses import PosedFingers
from ..errors import JGHandFailure
from . import armature, controls
from .controls import Touched

# the hand poses as Blender pose assets: one .blend file and its catalogs, made by scripts/build_pose_library.py
FOLDER = Path(__file__).resolve().parents[1] / "assets" / "poses"
LIBRARY_NAME = "JGHand"
BLEND = "jghand_poses.blend"
# Blender looks for this name in the folder of an asset library
CATALOG_FILE = "blender_assets.cats.txt"
# a view has the shelf once it was drawn in pose mode: how often, seconds, and how many times that is waited for
_SHELF_S, _SHELF_TRIES = 0.2, 10

_tries_left = 0
MOVING_BONES = tuple(name for finger in range(len(FINGERS)) for name in control_numbers.moving_bones(finger))
# the bones that move in the palm as fingers close: the first of index to pinky
KNUCKLES = tuple(control_numbers.moving_bones(finger)[0] for finger in range(1, len(FINGERS)))


@dataclass(frozen=True)
class PosedPart:
    """Which part of a hand is posed. bones: of the 15 that move · controls: those that are put back to neutral."""

    bones: frozenset[str]
    controls: frozenset[str]


WHOLE_HAND = PosedPart(frozenset(MOVING_BONES), frozenset(CONTROLS))


def chosen_part(hand: bpy.types.Object) -> PosedPart:
    """As Blender's pose library has it: in pose mode the selected bones, the whole hand where none is.

    A selected control stands for what it moves. The controls of a finger that is posed in part stay as they are, for
    they would move its other bones.
    """
    selected = versions.selected_bones(hand) if hand.mode == "POSE" else set()
    if not selected or HAND_CONTROL in selected:
        return WHOLE_HAND
    bones, neutral = set(), set()
    for finger in range(len(FINGERS)):
        own = {control_numbers.FINGER_CONTROLS[finger], control_numbers.TIP_CONTROLS[finger]}
        moving = set(control_numbers.moving_bones(finger))
        posed = moving if own & selected else moving & selected
        bones |= posed
        neutral |= own if posed == moving else set()
    return WHOLE_HAND if bones == WHOLE_HAND.bones else PosedPart(frozenset(bones), frozenset(neutral))


def take_pose(
    hand: bpy.types.Object, pose: PosedFingers, part: float = 1.0, only: PosedPart = WHOLE_HAND
) -> list[Touched]:
    """Turns finger bones and moves knuckles as the pose says, and puts controls back to neutral; the wrist stays.

    part: 0 to 1, how far from the bones' present turns and places towards the pose. Returns what it changed, for `key`.

    Raises JGHandFailure: not_a_hand, also for a pose of the other hand.
    """
    armature.rest_matrices_of(hand)  # refuses what has not all bones
    if armature.handedness_of(hand) != pose.handedness:
        raise JGHandFailure("not_a_hand", f"{hand.name} is no {pose.handedness} hand")
    touched = []
    for name, turn in pose.turns.items():
        if name in only.bones:
            bone = hand.pose.bones[name]
            touched.append(_set_turn(bone, _turn(bone).slerp(Quaternion(turn), part)))
    for name, way in pose.knuckles.items():
        if name in only.bones:
            bone = hand.pose.bones[name]
            bone.location = bone.location.lerp(_from_wrist(hand, name) * Vector(way), part)
            touched.append((bone, "location"))
    return touched + _reset_controls(hand, only)


def reset_pose(hand: bpy.types.Object, only: PosedPart = WHOLE_HAND) -> list[Touched]:
    """Fingers and controls back to rest; the wrist, and so the place of the hand, stays. Raises: not_a_hand.

    Returns what it changed.
    """
    armature.rest_matrices_of(hand)  # refuses what has not all bones
    touched: list[Touched] = []
    for name in MOVING_BONES:
        if name in only.bones:
            bone = hand.pose.bones[name]
            bone.location, bone.scale = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
            touched += [(bone, "location"), _set_turn(bone, Quaternion()), (bone, "scale")]
    return touched + _reset_controls(hand, only)


def copy_pose(source: bpy.types.Object, target: bpy.types.Object) -> list[Touched]:
    """Gives a hand the pose of another one, mirrored where that is the other hand; the wrist stays.

    Controls are copied where both have them; where only the target has, they go to neutral. Raises: not_a_hand.
    Returns what it changed.
    """
    for hand in (source, target):
        armature.rest_matrices_of(hand)
    mirrored = armature.handedness_of(source) != armature.handedness_of(target)
    touched = []
    for name in MOVING_BONES:
        w, x, y, z = _turn(source.pose.bones[name])
        turn = Quaternion((w, x, -y, -z) if mirrored else (w, x, y, z))
        touched.append(_set_turn(target.pose.bones[name], turn))
    for name in KNUCKLES:
        bone, size = target.pose.bones[name], _from_wrist(target, name) / _from_wrist(source, name)
        x, y, z = size * source.pose.bones[name].location
        bone.location = (-x if mirrored else x, y, z)
        touched.append((bone, "location"))
    if not (controls.has_controls(source) and controls.has_controls(target)):
        return touched + _reset_controls(target)
    return touched + _copy_controls(source, target, mirrored)


def still_acting(hand: bpy.types.Object, touched: Iterable[Touched]) -> list[str]:
    """Names of the controls that were not touched, yet are turned, or pin a tip, of fingers that were: what is seen is
    not the pose that was set."""
    if not controls.has_controls(hand) or controls.controls_are_muted(hand):
        return []
    names = {owner.name for owner, _ in touched}
    acting = [HAND_CONTROL] if names & set(MOVING_BONES) else []
    for finger in range(len(FINGERS)):
        if names & set(control_numbers.moving_bones(finger)):
            acting.append(control_numbers.FINGER_CONTROLS[finger])
            if controls.tip_rule(hand, finger).influence > 0:
                acting.append(control_numbers.TIP_CONTROLS[finger])
    tips = set(control_numbers.TIP_CONTROLS)
    return [
        name for name in acting if name not in names and (name in tips or any(hand.pose.bones[name].rotation_euler))
    ]


def key(touched: Iterable[Touched], frame: float) -> None:
    """Keys what was changed, and nothing else, at a frame; in the group of its bone, as Blender does."""
    for owner, path in touched:
        owner.keyframe_insert(path, frame=frame, group=owner.path_from_id().split('"')[1])


def _reset_controls(hand: bpy.types.Object, only: PosedPart = WHOLE_HAND) -> list[Touched]:
    return controls.reset_controls(hand, only.controls) if controls.has_controls(hand) else []


def _copy_controls(source: bpy.types.Object, target: bpy.types.Object, mirrored: bool) -> list[Touched]:
    touched: list[Touched] = []
    for name in CONTROLS:
        channel = control_numbers.channel(name)
        x, y, z = getattr(source.pose.bones[name], channel)
        way = (-x if mirrored and channel == "location" else x, y, z)
        setattr(target.pose.bones[name], channel, way)
        touched.append((target.pose.bones[name], channel))
    for finger in range(len(FINGERS)):
        rule = controls.tip_rule(target, finger)
        rule.influence = controls.tip_rule(source, finger).influence
        touched.append((rule, "influence"))
    controls.show_held_tips(target)
    return touched


def _from_wrist(hand: bpy.types.Object, name: str) -> float:
    """How far a bone is from the wrist at rest, in the armature's unit."""
    bones = hand.data.bones
    return (bones[name].head_local - bones[NAMES[WRIST]].head_local).length


def _turn(bone: bpy.types.PoseBone) -> Quaternion:
    """A bone's own turn, in whatever way the artist keeps it."""
    return bone.matrix_basis.to_quaternion()


def _set_turn(bone: bpy.types.PoseBone, turn: Quaternion) -> Touched:
    """The same, in the way that the bone's keys have: a quaternion curve is not seen by an Euler bone. Returns what it
    changed."""
    if bone.rotation_mode == "QUATERNION":
        bone.rotation_quaternion = turn
        return bone, "rotation_quaternion"
    if bone.rotation_mode == "AXIS_ANGLE":
        axis, angle = turn.to_axis_angle()
        bone.rotation_axis_angle = (angle, *axis)
        return bone, "rotation_axis_angle"
    bone.rotation_euler = turn.to_euler(bone.rotation_mode)
    return bone, "rotation_euler"


# ---- the pose library ------------------------------------------------------------------------------------------------


def use_library() -> str:
    """Makes the folder one of the user's asset libraries, once. Returns the name that it has there: ours may be taken
    by a library of the user's."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    return (library() or libraries.new(name=LIBRARY_NAME, directory=str(FOLDER))).name


def library() -> bpy.types.UserAssetLibrary | None:
    """Ours among the user's; None where it is not used."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    return next((library for library in libraries if Path(library.path) == FOLDER), None)


def show_shelf() -> None:
    """Shows the asset shelf in the views of the screen that is looked at, as soon as they have one."""
    global _tries_left
    if bpy.app.background:
        return
    _tries_left = _SHELF_TRIES
    if not bpy.app.timers.is_registered(_try_to_show):
        bpy.app.timers.register(_try_to_show, first_interval=_SHELF_S)


@clock.guarded(None)
def _try_to_show() -> float | None:
    global _tries_left
    _tries_left -= 1
    spaces = [area.spaces.active for _, area in ui.areas()]
    ready = [space for space in spaces if not space.is_property_readonly("show_region_asset_shelf")]
    for space in ready:
        space.show_region_asset_shelf = True
    return _SHELF_S if len(ready) < len(spaces) and _tries_left > 0 else None
