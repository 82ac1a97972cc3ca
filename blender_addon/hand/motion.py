# SPDX-License-Identifier: GPL-3.0-or-later
"""A motion onto an armature, as location and rotation keys of its 21 bones."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import bpy
import numpy as np

from .. import versions
from ..core import posing
from ..core.aside import aside, at_once, part_of
from ..core.controls import CONTROLS, RULES
from ..core.joints import NAMES
from ..errors import JGHandFailure
from .armature import build_armature, handedness_of, rest_matrices_of
from .motion_files import MotionFile

# the channels of a bone that a driver may hold, whatever its keys say
_CHANNELS = ("location", "rotation_quaternion", "rotation_euler", "rotation_axis_angle", "rotation_mode", "scale")
# what a motion takes the place of: those of the 21 bones and of the controls, and how much our constraints do
_REPLACED = re.compile(
    rf'pose\.bones\["(?:{"|".join((*NAMES, *CONTROLS))})"\]\.'
    rf'(?:(?:{"|".join(_CHANNELS)})|constraints\["(?:{"|".join(RULES)})"\]\..*)'
)


def key_motion(
    hand: bpy.types.Object,
    joints_m: np.ndarray,
    scene: bpy.types.Scene,
    *,
    first_frame: float = 1.0,
    frames_per_pose: float = 1.0,
    key_frames: Sequence[float] | None = None,
) -> bpy.types.Action:
    """Keys (F, 21, 3) joints, meters in the space of the armature object, standard order; returns the new action.

    At every key the evaluated bone heads equal the joints, also where bone lengths or the palm change. Between keys
    Blender interpolates linearly. `frames_per_pose` is the scene's frame rate over the motion's; `key_frames` places
    every key instead. The action before it stays in the file; what it animates besides the 21 bones and the controls
    (the object's place, whether it is rendered) goes on. For that the 21 bones turn by quaternions, have no scale of
    their own and follow their parents; what else moves them is the artist's, so it is refused and not switched off.
    Bones above the wrist are not undone.
    Raises JGHandFailure (bad_joints, not_a_hand, constrained) before anything is changed.
    """
    at_once(
        key_steps(
            hand, joints_m, scene, first_frame=first_frame, frames_per_pose=frames_per_pose, key_frames=key_frames
        )
    )
    return hand.animation_data.action


def key_steps(
    hand: bpy.types.Object,
    joints_m: np.ndarray,
    scene: bpy.types.Scene,
    *,
    first_frame: float = 1.0,
    frames_per_pose: float = 1.0,
    key_frames: Sequence[float] | None = None,
    filled: np.ndarray | None = None,
) -> Generator[float, None, None]:
    """`key_motion` in turns: yields the part that is done. Closed half-way, the hand has its action of before.

    filled: (F,) bool, poses that nobody measured: their keys are of Blender's kind Jitter, which is shown and selected
    apart.
    """
    check_free(hand)
    joints = posing.checked_joints(joints_m) / scene.unit_settings.scale_length
    keys = yield from aside(partial(posing.bone_keys, joints, rest_matrices_of(hand), handedness_of(hand)))
    if key_frames is None:
        frames = first_frame + frames_per_pose * np.arange(len(joints))
    else:
        frames = np.array(key_frames, dtype=np.float64)
    put_back = _keep(hand)
    whole = False
    try:
        versions.new_action(hand, f"{hand.name} motion", replaces=lambda path: _REPLACED.fullmatch(path) is not None)
        for place, name in enumerate(NAMES):
            for channel, values in (("location", keys.location), ("rotation_quaternion", keys.quaternion)):
                for index in range(values.shape[-1]):
                    curve = versions.new_fcurve(hand, f'pose.bones["{name}"].{channel}', index, name)
                    _fill(curve, frames, values[:, place, index], filled)
            yield (place + 1) / len(NAMES)
        _prepare_bones(hand)
        whole = True
    finally:
        if not whole:
            put_back()


@dataclass(frozen=True)
class ImportedMotion:
    """A motion on an armature. notes: what was repaired, in sentences."""

    hand: bpy.types.Object
    action: bpy.types.Action
    notes: tuple[str, ...]


def import_motion(
    context: bpy.types.Context,
    motion: MotionFile,
    name: str,
    *,
    hand: bpy.types.Object | None = None,
    first_frame: float = 1.0,
) -> ImportedMotion:
    """Keys the motion of a file, at the scene's frame rate, on an armature of ours or on a new one of its proportions.

    The joints are keyed where they are, in the armature object's space. The scene's frame rate and range stay.
    Raises JGHandFailure: other_hand and what `key_motion` raises, before anything is changed.
    """
    return at_once(import_steps(context, motion, name, hand=hand, first_frame=first_frame))


def import_steps(
    context: bpy.types.Context,
    motion: MotionFile,
    name: str,
    *,
    hand: bpy.types.Object | None = None,
    first_frame: float = 1.0,
) -> Generator[float, None, ImportedMotion]:
    """`import_motion` in turns: yields the part that is done. Closed half-way, nothing is left of it."""
    scene = context.scene
    new = None
    if hand is None:
        rest = posing.rest_joints_m(motion.handedness, motion.joints_m)
        hand = new = build_armature(context, name, rest, motion.handedness)
    elif handedness_of(hand) != motion.handedness:
        raise JGHandFailure("other_hand", f"{hand.name}: {handedness_of(hand)}, the motion: {motion.handedness}")
    scene_fps = scene.render.fps / scene.render.fps_base
    whole = False
    try:
        yield from key_steps(
            *(hand, motion.joints_m, scene),
            first_frame=first_frame,
            frames_per_pose=scene_fps / motion.fps,
            filled=motion.filled,
        )
        whole = True
    finally:
        if new is not None and not whole:
            bpy.data.armatures.remove(new.data)  # and with it the object
    action = hand.animation_data.action
    action.name = name
    return ImportedMotion(hand, action, motion.notes)


@dataclass(frozen=True)
class WantedMotion:
    """A motion that is to be keyed. name: of its action, and of a new hand · hand: None for a new one."""

    motion: MotionFile
    name: str
    hand: bpy.types.Object | None = None


def import_all_steps(
    context: bpy.types.Context, wanted: Sequence[WantedMotion], *, first_frame: float = 1.0
) -> Generator[float, None, list[ImportedMotion]]:
    """`import_steps` of several motions on different hands. Closed half-way, or where one of them fails, nothing is
    left of any."""
    done = []
    with contextlib.ExitStack() as undo:
        for number, one in enumerate(wanted):
            put_back = _keep(one.hand) if one.hand is not None else None
            steps = import_steps(context, one.motion, one.name, hand=one.hand, first_frame=first_frame)
            made = yield from part_of(steps, number / len(wanted), 1.0 / len(wanted))
            undo.callback(put_back or partial(_remove, made))
            done.append(made)
        undo.pop_all()
    return done


def _remove(made: ImportedMotion) -> None:
    """Takes a new hand away again, and its action."""
    bpy.data.armatures.remove(made.hand.data)  # and with it the object
    bpy.data.actions.remove(made.action)


def check_free(hand: bpy.types.Object, *, but: Sequence[str] = ()) -> None:
    """Refuses a hand whose bones are moved by more than their keys and constraints with the names `but`."""
    bones = [hand.pose.bones[name] for name in NAMES if name in hand.pose.bones]
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


def _keep(hand: bpy.types.Object) -> Callable[[], None]:
    """What gives a hand back the action, the pose and the settings of its bones that it has now."""
    give_action = versions.keep_action(hand)
    kept = {
        bone.name: {
            # the mode first: Blender turns the rotation of the old one into it
            **{name: _value(getattr(bone, name)) for name in ("rotation_mode", *_CHANNELS)},
            "use_inherit_rotation": bone.bone.use_inherit_rotation,
            "use_local_location": bone.bone.use_local_location,
        }
        for bone in hand.pose.bones
        if bone.name in NAMES
    }

    def put_back() -> None:
        give_action()
        for name, values in kept.items():
            pose = hand.pose.bones[name]
            for channel, value in values.items():
                owner = pose if channel in _CHANNELS else pose.bone
                if _value(getattr(owner, channel)) != value:
                    setattr(owner, channel, value)

    return put_back


def _value(value: Any) -> Any:
    """A property's value, apart from Blender's data."""
    return value if isinstance(value, str | bool) else tuple(value)


def _prepare_bones(hand: bpy.types.Object) -> None:
    """What the keys take for granted about the bones."""
    for name in NAMES:
        pose = hand.pose.bones[name]
        pose.rotation_mode = "QUATERNION"
        pose.scale = (1.0, 1.0, 1.0)
        pose.bone.use_inherit_rotation = pose.bone.use_local_location = True


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
