# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that show a hand over a whole motion: wrist and fingertips inside the picture, with some air."""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix

from ..core import limits, posing
from ..core.joints import LEFT, WRIST

# name -> direction from the hand to the camera: to the index side, to the fingers, out of the palm
SIDES = {"CamPalm": (0.0, 0.15, 1.0), "CamSide": (0.85, 0.2, 0.5)}


def add_framing_camera(
    context: bpy.types.Context, name: str, joints_m: np.ndarray, handedness: str
) -> bpy.types.Object:
    """A camera on the side `name` (a key of SIDES) that shows (F, 21, 3) world joints, metres, in every frame.

    The scene must have its picture size already.
    """
    joints = posing.checked_joints(joints_m)
    unit_m = context.scene.unit_settings.scale_length
    palm = posing.palm_axes(joints.mean(0, keepdims=True), handedness)[0]
    back = palm @ (np.array(SIDES[name]) * (-1.0 if handedness == LEFT else 1.0, 1.0, 1.0))
    back /= np.linalg.norm(back)
    right = np.cross(palm[:, 1], back)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(back, right), back], -1)
    data = bpy.data.cameras.new(name)
    data.lens = limits.LENS_MM
    data.clip_start = limits.CLIP_START_M / unit_m
    camera = bpy.data.objects.new(name, data)
    context.scene.collection.objects.link(camera)
    camera.matrix_world = _matrix(axes, np.zeros(3))
    points = _skin_points(joints) / unit_m
    depsgraph = context.evaluated_depsgraph_get()
    place = np.array(camera.camera_fit_coords(depsgraph, points.ravel().tolist())[0])
    distance = np.median((place - points) @ back)
    camera.matrix_world = _matrix(axes, place + back * distance * limits.MARGIN)
    return camera


def _skin_points(joints: np.ndarray) -> np.ndarray:
    """(N, 3) points around every joint of every frame that the skin stays within, metres."""
    reach = np.full(joints.shape[1], limits.SKIN_M)
    reach[WRIST] = limits.WRIST_SKIN_M
    offsets = np.concatenate([np.eye(3), -np.eye(3)])
    return (joints[:, :, None, :] + reach[:, None, None] * offsets).reshape(-1, 3)


def _matrix(axes: np.ndarray, place: np.ndarray) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, place
    return Matrix(matrix)
