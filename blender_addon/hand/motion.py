# SPDX-License-Identifier: GPL-3.0-or-later
"""A motion onto an armature, as location and rotation keys of its 21 bones."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from .. import versions
from ..core import posing
from ..core.controls import CONTROLS, RULES
from ..core.joints import FOREARM, NAMES
from ..errors import JGHandFailure
from .armature import (
    add_forearm,
    build_armature,
    check_scale,
    evaluated_object,
    handedness_of,
    has_forearm_bone,
    rest_matrices_of,
    shown_handedness,
)
from .motion_files import MotionFile

# the channels of a bone that a driver may hold, whatever its keys say
_CHANNELS = ("location", "rotation_quaternion", "rotation_euler", "rotation_axis_angle", "rotation_mode", "scale")
# what a motion takes the place of: those of the 21 bones and of the controls, and how much our constraints do
_REPLACED = re.compile(
    rf'pose\.bones\["(?:{"|".join((*NAMES, FOREARM, *CONTROLS))})"\]\.'
    rf'(?:(?:{"|".join(_CHANNELS)})|constraints\["(?:{"|".join(RULES)})"\]\..*)'
)


@dataclass(frozen=True)
class WantedMotion:
    """A motion that is to be keyed. name: of its action, and of a new hand · hand: None for a new one."""

    motion: MotionFile
    name: str
    hand: bpy.types.Object | None = None


def import_motions(
    context: bpy.types.Context,
    wanted: Sequence[WantedMotion],
    *,
    first_frame: float = 1.0,
    origin_m: np.ndarray | None = None,
    set_rate: bool = False,
) -> list[bpy.types.Object]:
    """Keys motions at the scene's frame rate, each on its hand or on a new one of its proportions; returns the hands.

    One that says how the forearm turns brings a bone for it, but not where hands share their armature or have it from
    another file: there that is left out.

    A motion has the axes and the meters of the world, however the object of its hand, and what that hangs on, is turned
    and scaled now; a mirrored hand takes motions of the other side, which it shows. Its origin is where the object
    stands, and the world's for a new hand.
    origin_m: (3,) in the world, meters, one origin for all instead; new hands' objects then stand there ·
    set_rate: the scene's frame rate becomes that of the first motion. Our own constraints may act on a hand: whoever
    calls makes them neutral. Raises JGHandFailure (other_hand, not_a_hand, constrained, bad_joints, zero_scale, hidden)
    before anything is changed.
    """
    context.view_layer.update()
    depsgraph = context.evaluated_depsgraph_get()
    joints_m = [_checked_joints(one, depsgraph, origin_m) for one in wanted]
    scene = context.scene
    if set_rate and wanted:
        scene.render.fps = max(1, round(wanted[0].motion.fps))
        scene.render.fps_base = scene.render.fps / wanted[0].motion.fps
    hands = []
    for one, joints in zip(wanted, joints_m, strict=True):
        hand = one.hand
        if hand is None:
            hand = build_armature(
                context,
                one.name,
                posing.rest_joints_m(one.motion.handedness, joints),
                one.motion.handedness,
                forearm=one.motion.forearm is not None,
            )
            hand.location = (0, 0, 0) if origin_m is None else origin_m / scene.unit_settings.scale_length
        elif one.motion.forearm is not None and not has_forearm_bone(hand) and _takes_bones(hand.data):
            add_forearm(context, hand)
        frames = first_frame + frame_rate(scene) / one.motion.fps * np.arange(len(joints))
        key_motion(hand, joints, scene, frames, filled=one.motion.filled, turns=one.motion.forearm).name = one.name
        hands.append(hand)
    return hands


def _takes_bones(bones: bpy.types.Armature) -> bool:
    return bones.users == 1 and bones.is_editable and not bones.override_library


def frame_rate(scene: bpy.types.Scene) -> float:
    """Frames per second."""
    return scene.render.fps / scene.render.fps_base


def key_motion(
    hand: bpy.types.Object,
    joints_m: np.ndarray,
    scene: bpy.types.Scene,
    frames: Sequence[float] | np.ndarray,
    *,
    filled: np.ndarray | None = None,
    turns: np.ndarray | None = None,
) -> bpy.types.Action:
    """Keys (F, 21, 3) joints, meters in the space of the armature object, standard order, at F frames; returns the new
    action.

    At every key the evaluated bone heads equal the joints, also where bone lengths or the palm change. Between keys
    Blender interpolates linearly. The action before it stays in the file; what it animates besides the 21 bones and the
    controls (the object's place, whether it is rendered) goes on. For that the 21 bones turn by quaternions, have no
    scale of their own and follow their parents. Bones above the wrist are not undone.
    filled: (F,) bool, poses that nobody measured: their keys are of Blender's kind Jitter, which is shown and selected
    apart. turns: (F, 4) of the forearm, see `posing.forearm_rotations`; None: it goes with the palm. Where the armature
    has a bone for it, that carries the hand. Raises JGHandFailure: bad_joints, not_a_hand.
    """
    joints = posing.checked_joints(joints_m) / scene.unit_settings.scale_length
    forearm = None
    if has_forearm_bone(hand):
        rest = np.array(hand.data.bones[FOREARM].matrix_local, np.float64)
        forearm = rest, np.tile((1.0, 0.0, 0.0, 0.0), (len(joints), 1)) if turns is None else turns
    keys = posing.bone_keys(joints, rest_matrices_of(hand), handedness_of(hand), forearm)
    at = np.asarray(frames, dtype=np.float64)
    action = versions.new_action(
        hand, f"{hand.name} motion", replaces=lambda path: _REPLACED.fullmatch(path) is not None
    )
    for place, name in enumerate(_keyed(hand)):
        for channel, values in (("location", keys.location), ("rotation_quaternion", keys.quaternion)):
            for index in range(values.shape[-1]):
                curve = versions.new_fcurve(hand, f'pose.bones["{name}"].{channel}', index, name)
                _fill(curve, at, values[:, place, index], filled)
    for name in _keyed(hand):  # what the keys take for granted
        pose = hand.pose.bones[name]
        pose.rotation_mode, pose.scale = "QUATERNION", (1.0, 1.0, 1.0)
        pose.bone.use_inherit_rotation = pose.bone.use_local_location = True
    return action


def _checked_joints(one: WantedMotion, depsgraph: bpy.types.Depsgraph, origin_m: np.ndarray | None) -> np.ndarray:
    """(F, 21, 3) joints of a motion that can be keyed, in the space of the object that takes it, meters."""
    motion, hand = one.motion, one.hand
    joints = posing.checked_joints(motion.joints_m)
    posing.palm_axes(joints, motion.handedness)
    if hand is None:
        posing.rest_matrices(posing.rest_joints_m(motion.handedness, joints), motion.handedness)
        return joints
    if shown_handedness(hand) != motion.handedness:
        raise JGHandFailure("other_hand", f"{hand.name}: {shown_handedness(hand)}, the motion: {motion.handedness}")
    rest_matrices_of(hand)
    check_free(hand, but=RULES)
    world = np.array(evaluated_object(hand, depsgraph).matrix_world, dtype=np.float64)
    linear = world[:3, :3]
    check_scale(linear, hand.name)
    if origin_m is not None:
        joints = joints + origin_m - depsgraph.scene.unit_settings.scale_length * world[:3, 3]
    return joints @ np.linalg.inv(linear).T


def check_free(hand: bpy.types.Object, *, but: Sequence[str] = ()) -> None:
    """Refuses a hand whose bones are moved by more than their keys and constraints with the names `but`."""
    bones = [hand.pose.bones[name] for name in _keyed(hand) if name in hand.pose.bones]
    movers = [
        f"{bone.name}: {rule.name}"
        for bone in bones
        for rule in bone.constraints
        if not (rule.mute or rule.name in but)
    ]
    drivers = hand.animation_data.drivers if hand.animation_data else ()
    paths = tuple(f'pose.bones["{bone.name}"].{channel}' for bone in bones for channel in _CHANNELS)
    movers += [f"driver of {curve.data_path}" for curve in drivers if curve.data_path in paths and not curve.mute]
    if movers:
        raise JGHandFailure("constrained", f"{hand.name}, {'; '.join(movers)}")


def _keyed(hand: bpy.types.Object) -> tuple[str, ...]:
    """The bones that a motion moves, as `posing.bone_keys` lists them."""
    return (*NAMES, FOREARM) if has_forearm_bone(hand) else NAMES


def _fill(curve: bpy.types.FCurve, frames: np.ndarray, values: np.ndarray, filled: np.ndarray | None) -> None:
    """All keys of an empty curve at once, linear between them; those of poses that were filled in are marked."""
    points = curve.keyframe_points
    points.add(len(frames))
    points.foreach_set("co", np.stack([frames, values], -1).astype(np.float32).ravel())
    kinds = bpy.types.Keyframe.bl_rna.properties
    linear = kinds["interpolation"].enum_items["LINEAR"].value
    points.foreach_set("interpolation", np.full(len(frames), linear, np.int32))
    if filled is not None:
        seen, jitter = (kinds["type"].enum_items[name].value for name in ("KEYFRAME", "JITTER"))
        points.foreach_set("type", np.where(filled, jitter, seen).astype(np.int32))
    curve.update()
