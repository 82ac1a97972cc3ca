# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras that show a hand whole: wrist and fingertips inside the picture, with some air."""

from __future__ import annotations

import math
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core import posing
from ..core.joints import LEFT, WRIST
from ..core.view import CLIP_START_M
from ..render.camera import set_picture_size

# how far skin reaches beyond a joint, and how much is shown behind the wrist joint, meters: the end of a hand that has
# no forearm; one that is longer goes on out of the picture, so that the hand fills it
SKIN_M, WRIST_SKIN_M = 0.015, 0.045
# air around the hand, as a part of the distance
MARGIN = 0.06
# focal length of new cameras, mm on a 36 mm sensor: a portrait lens, little perspective on so near a thing
LENS_MM = 85.0
# how large a new camera is drawn in views, meters: less than the hand that it looks at, across which Blender's 1 m goes
CAMERA_SIZE_M = 0.05
# name -> direction from the hand to the camera: to the index side, to the fingers, out of the palm
SIDES = {"CamPalm": (0.0, 0.15, 1.0), "CamSide": (0.85, 0.2, 0.5)}


def add_framing_camera(
    context: bpy.types.Context, name: str, joints_m: np.ndarray, handedness: str
) -> bpy.types.Object:
    """A camera on the side `name` (a key of SIDES) that shows (F, 21, 3) world joints, meters, in every frame.

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
    data.lens = LENS_MM
    data.clip_start = CLIP_START_M / unit_m
    camera = bpy.data.objects.new(name, data)
    context.scene.collection.objects.link(camera)
    camera.matrix_world = _matrix(axes, np.zeros(3))
    points = _skin_points(joints) / unit_m
    depsgraph = context.evaluated_depsgraph_get()
    place = np.array(camera.camera_fit_coords(depsgraph, points.ravel().tolist())[0])
    distance = np.median((place - points) @ back)
    camera.matrix_world = _matrix(axes, place + back * distance * MARGIN)
    data.display_size = CAMERA_SIZE_M / unit_m
    return camera


def add_film_camera(
    context: bpy.types.Context, film: Path, size_px: tuple[int, int], angle: float, first_frame: int
) -> tuple[bpy.types.Object, bool]:
    """The scene's new camera, at the world's origin and looking along y, with a film that plays behind what it sees
    from `first_frame` on; the scene's images get the film's size. Also whether this Blender can play the film.

    size_px: width and height as the film was looked at, which may be smaller than it is · angle: of view across its
    longer edge, radians.
    """
    scene = context.scene
    data = bpy.data.cameras.new(film.stem)
    data.sensor_fit, data.angle = "AUTO", angle  # the longer edge
    data.clip_start = CLIP_START_M / scene.unit_settings.scale_length
    camera = bpy.data.objects.new(film.stem, data)
    camera.rotation_euler.x = math.pi / 2
    scene.collection.objects.link(camera)
    scene.camera = camera
    clip = bpy.data.movieclips.load(str(film))
    clip.frame_start = first_frame
    behind = data.background_images.new()
    behind.source, behind.clip, behind.alpha = "MOVIE_CLIP", clip, 1.0
    behind.frame_method = "STRETCH"  # pixels of a film may be oblong
    data.show_background_images = True
    larger = max(clip.size) / max(size_px) if clip.frame_duration else 1.0
    set_picture_size(scene.render, *(round(larger * edge) for edge in size_px))
    return camera, clip.frame_duration > 0


def look_through_camera(area: bpy.types.Area | None) -> None:
    """Shows what the scene's camera sees in a 3D view; any other area stays as it is."""
    if area is not None and area.type == "VIEW_3D":
        area.spaces.active.region_3d.view_perspective = "CAMERA"


def _skin_points(joints: np.ndarray) -> np.ndarray:
    """(N, 3) points around every joint of every frame that the skin stays within, meters."""
    reach = np.full(joints.shape[1], SKIN_M)
    reach[WRIST] = WRIST_SKIN_M
    offsets = np.concatenate([np.eye(3), -np.eye(3)])
    return (joints[:, :, None, :] + reach[:, None, None] * offsets).reshape(-1, 3)


def _matrix(axes: np.ndarray, place: np.ndarray) -> Matrix:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = axes, place
    return Matrix(matrix)
