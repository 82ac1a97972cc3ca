# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole poses of our armature: taking one, taking the other hand's, going back to rest, and keying what was posed.

The left hand's bones have the mirrored axes of the right hand's (`core.posing`), so that a turn (w, x, y, z) becomes
(w, x, -y, -z) and a way (x, y, z) becomes (-x, y, z) on the other hand; turns of the controls are the same on both.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
from mathutils import Quaternion, Vector

from ..core import controls as control_numbers
from ..core.controls import FINGER_CONTROLS, HAND_CONTROL, TIP_CONTROLS
from ..core.joints import FINGERS
from ..core.messages import JGHandFailure
from ..core.poses import HandPose
from . import armature, controls

MOVING_BONES = tuple(name for finger in range(len(FINGERS)) for name in control_numbers.moving_bones(finger))


def take_pose(hand: bpy.types.Object, pose: HandPose, part: float = 1.0) -> None:
    """Turns the finger bones as the pose says, and puts controls back to neutral; the wrist stays.

    part: 0 to 1, how far from the bones' present turns towards the pose.

    Raises JGHandFailure: not_a_hand, also for a pose of the other hand.
    """
    armature.rest_matrices_of(hand)  # refuses what has not all bones
    if armature.handedness_of(hand) != pose.handedness:
        raise JGHandFailure("not_a_hand", f"{hand.name} is no {pose.handedness} hand")
    for name, turn in pose.turns.items():
        bone = hand.pose.bones[name]
        _set_turn(bone, _turn(bone).slerp(Quaternion(turn), part))
    if controls.has_controls(hand):
        controls.reset_controls(hand)


def reset_pose(hand: bpy.types.Object) -> None:
    """Fingers and controls back to rest; the wrist, and so the place of the hand, stays. Raises: not_a_hand."""
    armature.rest_matrices_of(hand)  # refuses what has not all bones
    for name in MOVING_BONES:
        bone = hand.pose.bones[name]
        bone.location, bone.scale = (0.0, 0.0, 0.0), (1.0, 1.0, 1.0)
        _set_turn(bone, Quaternion())
    if controls.has_controls(hand):
        controls.reset_controls(hand)


def copy_pose(source: bpy.types.Object, target: bpy.types.Object) -> None:
    """Gives a hand the pose of another one, mirrored where that is the other hand; the wrist stays.

    Controls are copied where both have them; where only the target has, they go to neutral. Raises: not_a_hand.
    """
    for hand in (source, target):
        armature.rest_matrices_of(hand)
    mirrored = armature.handedness_of(source) != armature.handedness_of(target)
    for name in MOVING_BONES:
        w, x, y, z = _turn(source.pose.bones[name])
        _set_turn(target.pose.bones[name], Quaternion((w, x, -y, -z) if mirrored else (w, x, y, z)))
    if not controls.has_controls(target):
        return
    if not controls.has_controls(source):
        controls.reset_controls(target)
        return
    for name in (HAND_CONTROL, *FINGER_CONTROLS):
        target.pose.bones[name].rotation_euler = source.pose.bones[name].rotation_euler
    for name in TIP_CONTROLS:
        x, y, z = source.pose.bones[name].location
        target.pose.bones[name].location = Vector((-x if mirrored else x, y, z))
    for finger in range(len(FINGERS)):
        controls.tip_rule(target, finger).influence = controls.tip_rule(source, finger).influence
    controls.show_held_tips(target)


def key_pose(hand: bpy.types.Object, frame: float) -> None:
    """Keys of the fingers, and of the controls where there are any, at a frame."""
    for path, bone in _keyed(hand):
        bone.keyframe_insert(path, frame=frame, group=bone.name)


def _keyed(hand: bpy.types.Object) -> Iterator[tuple[str, bpy.types.PoseBone]]:
    for name in MOVING_BONES:
        bone = hand.pose.bones[name]
        yield _PATHS.get(bone.rotation_mode, "rotation_euler"), bone
    if controls.has_controls(hand):
        for name in (HAND_CONTROL, *FINGER_CONTROLS):
            yield "rotation_euler", hand.pose.bones[name]


_PATHS = {"QUATERNION": "rotation_quaternion", "AXIS_ANGLE": "rotation_axis_angle"}


def _turn(bone: bpy.types.PoseBone) -> Quaternion:
    """A bone's own turn, in whatever way the artist keeps it."""
    return bone.matrix_basis.to_quaternion()


def _set_turn(bone: bpy.types.PoseBone, turn: Quaternion) -> None:
    """The same, in the way that the bone's keys have: a quaternion curve is not seen by an Euler bone."""
    if bone.rotation_mode == "QUATERNION":
        bone.rotation_quaternion = turn
    elif bone.rotation_mode == "AXIS_ANGLE":
        axis, angle = turn.to_axis_angle()
        bone.rotation_axis_angle = (angle, *axis)
    else:
        bone.rotation_euler = turn.to_euler(bone.rotation_mode)
