"""A motion onto an armature, as location and rotation keys of its 21 bones."""

from __future__ import annotations

import bpy
import numpy as np

from ..core import posing
from ..core.joints import NAMES
from . import versions
from .armature import handedness_of, rest_matrices_of


def key_motion(
    hand: bpy.types.Object,
    joints_m: np.ndarray,
    scene: bpy.types.Scene,
    *,
    first_frame: float = 1.0,
    frames_per_pose: float = 1.0,
) -> bpy.types.Action:
    """Keys (F, 21, 3) joints, metres in the space of the armature object, standard order; returns the new action.

    At every key the evaluated bone heads equal the joints, also where bone lengths or the palm change. Between keys
    Blender interpolates linearly. `frames_per_pose` is the scene's frame rate over the motion's. The action before it
    stays in the file. Raises JGHandFailure (bad_joints, not_a_hand).
    """
    joints = posing.checked_joints(joints_m) / scene.unit_settings.scale_length
    keys = posing.bone_keys(joints, rest_matrices_of(hand), handedness_of(hand))
    frames = first_frame + frames_per_pose * np.arange(len(joints))
    action = versions.new_action(hand, f"{hand.name} motion")
    for place, name in enumerate(NAMES):
        for channel, values in (("location", keys.location), ("rotation_quaternion", keys.quaternion)):
            for index in range(values.shape[-1]):
                curve = versions.new_fcurve(hand, f'pose.bones["{name}"].{channel}', index, name)
                _fill(curve, frames, values[:, place, index])
    return action


def _fill(curve: bpy.types.FCurve, frames: np.ndarray, values: np.ndarray) -> None:
    """All keys of an empty curve at once, linear between them."""
    points = curve.keyframe_points
    points.add(len(frames))
    points.foreach_set("co", np.stack([frames, values], -1).astype(np.float32).ravel())
    linear = bpy.types.Keyframe.bl_rna.properties["interpolation"].enum_items["LINEAR"].value
    points.foreach_set("interpolation", np.full(len(frames), linear, np.int32))
    curve.update()
