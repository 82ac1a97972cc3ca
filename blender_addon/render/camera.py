# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender camera, or a 3D view, as the pinhole of the engine, and new cameras that show a hand.
Source: BLENDER 6 (the formula), 7.1, 8.1."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from ..core import posing
from ..core.joints import LEFT, WRIST
from ..core.view import CLIP_START_M, HandInSpace, Part, Pinhole, pinhole_from
from ..errors import JGHandFailure
from ..hand.armature import evaluated_object

# a camera whose normalized axes leave orthogonality by more than this is sheared by its parents
_SHEAR_MAX = 1e-4


def picture_size(render: bpy.types.RenderSettings) -> tuple[int, int]:
    """Width and height in pixels, percentage applied and rounded down as Blender does."""
    percentage = render.resolution_percentage
    return max(1, render.resolution_x * percentage // 100), max(1, render.resolution_y * percentage // 100)


def pinhole(camera: bpy.types.Object, depsgraph: bpy.types.Depsgraph, size: tuple[int, int] | None = None) -> Pinhole:
    """The *evaluated* camera (lens, shift, sensor fit, pixel aspect, depth of field, unit of the scene), meters.

    size: of the picture, where it is not the scene's own.
    Raises JGHandFailure: not_a_camera, panoramic, orthographic_lens, sheared_camera, hidden.
    """
    if camera.type != "CAMERA":
        raise JGHandFailure("not_a_camera", camera.name)
    evaluated = evaluated_object(camera, depsgraph)
    _check_kind(evaluated)
    scene = depsgraph.scene
    unit_m = scene.unit_settings.scale_length
    width, height = size or picture_size(scene.render)
    projection = evaluated.calc_matrix_camera(
        depsgraph, x=width, y=height, scale_x=scene.render.pixel_aspect_x, scale_y=scene.render.pixel_aspect_y
    )
    orthographic = evaluated.data.type == "ORTHO"
    camera_from_world = _camera_from_world(evaluated, unit_m)
    view = pinhole_from(np.array(projection), camera_from_world, (width, height), unit_m, orthographic=orthographic)
    aperture_m, focus_m = _lens(evaluated, unit_m)
    return replace(view, aperture_m=aperture_m, focus_m=focus_m)


def region(render: bpy.types.RenderSettings, size: tuple[int, int] | None = None) -> Part:
    """The part of the picture that is rendered, the whole or the render region, rounded as Blender rounds it.

    size: of the picture, where it is not the scene's own. Raises JGHandFailure (empty_region).
    """
    width, height = size or picture_size(render)
    if not render.use_border:
        return Part(0, 0, width, height)
    # Blender multiplies in single precision and cuts; it counts rows from the bottom
    left, right = (int(np.float32(edge) * np.float32(width)) for edge in (render.border_min_x, render.border_max_x))
    bottom, top = (int(np.float32(edge) * np.float32(height)) for edge in (render.border_min_y, render.border_max_y))
    if right <= left or top <= bottom:
        raise JGHandFailure("empty_region")
    return Part(left, height - top, right, height - bottom)


def set_picture_size(render: bpy.types.RenderSettings, width: int, height: int) -> None:
    """Width and height in pixels, square ones, at 100 percent."""
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    render.pixel_aspect_x = render.pixel_aspect_y = 1.0


def _check_kind(camera: bpy.types.Object) -> None:
    if camera.data.type not in ("PERSP", "ORTHO"):
        raise JGHandFailure("panoramic", camera.name)
    if camera.data.type == "ORTHO" and camera.data.dof.use_dof:
        raise JGHandFailure("orthographic_lens", camera.name)


def _lens(camera: bpy.types.Object, unit_m: float) -> tuple[float, float]:
    """Diameter of the aperture, 0 without depth of field, and the depth that is sharp, meters, of an evaluated camera.

    As Cycles has it: the aperture is a part of the focal length in thousandths of a Blender unit, whatever that is.
    """
    depth_of_field = camera.data.dof
    if not depth_of_field.use_dof:
        return 0.0, 1.0
    return 1e-3 * camera.data.lens / depth_of_field.aperture_fstop * unit_m, unit_m * _focus_distance(camera)


def _focus_distance(camera: bpy.types.Object) -> float:
    """Blender units along the view axis: to the object, or the bone of it, that the camera focuses on, else as set."""
    depth_of_field = camera.data.dof
    focused = depth_of_field.focus_object
    if focused is None:
        return depth_of_field.focus_distance
    place = focused.matrix_world
    bone = focused.pose.bones.get(depth_of_field.focus_subtarget) if focused.pose is not None else None
    if bone is not None:
        place = place @ bone.matrix
    axis = camera.matrix_world.col[2].to_3d().normalized()
    return abs((place.translation - camera.matrix_world.translation).dot(axis))


def _camera_from_world(camera: bpy.types.Object, unit_m: float) -> np.ndarray:
    """(4, 4), Blender's axes, meters; scale is left out as Blender leaves it out, a shear or a mirror is refused."""
    world_from_camera = np.array(camera.matrix_world, dtype=np.float64)
    axes = world_from_camera[:3, :3]
    size = np.linalg.norm(axes, axis=0)
    if size.min() <= 0:
        raise JGHandFailure("zero_scale", camera.name)
    axes = axes / size
    if np.abs(axes.T @ axes - np.eye(3)).max() > _SHEAR_MAX or np.linalg.det(axes) < 0:
        raise JGHandFailure("sheared_camera", camera.name)
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = axes.T, -axes.T @ world_from_camera[:3, 3] * unit_m
    return result


# ---- 3D views --------------------------------------------------------------------------------------------------------

# an orthographic view of Blender has things behind its camera: the renderer's camera stands so far in front of the
# nearest joint, meters
ORTHO_ROOM_M = 0.5


@dataclass(frozen=True)
class ViewCamera:
    """The camera of a 3D view. whole: of the whole region, meters · window: (4, 4) Blender's projection matrix ·
    unit_m: meters per unit of the scene"""

    whole: Pinhole
    window: np.ndarray
    unit_m: float

    @property
    def parts(self) -> tuple[bytes | str, ...]:
        size = f"{self.whole.width}x{self.whole.height}, {self.unit_m!r}"
        return (size, self.whole.camera_from_world.tobytes(), self.window.tobytes())

    def in_front_of(self, hands: Sequence[HandInSpace]) -> tuple[Pinhole, float]:
        """The pinhole, moved back until it has the hands in front of it, and by how much, meters.

        An orthographic view of Blender's shows what is behind its camera as well; moving it changes nothing but depth.
        """
        if not self.whole.orthographic or not hands:
            return self.whole, 0.0
        nearest_m = min(self.whole.project(hand.joints_world_m)[:, 2].min() for hand in hands)
        room_m = max(0.0, ORTHO_ROOM_M - float(nearest_m))
        camera = self.whole.camera_from_world.copy()
        camera[2, 3] += room_m
        return replace(self.whole, camera_from_world=camera), room_m

    def clip_of_depth(self, room_m: float) -> tuple[float, float, float, float]:
        """(a, b, c, d) so that a point at the engine's depth z has clip depth a z + b over clip w c z + d."""
        per_m = 1.0 / self.unit_m
        a, c = -self.window[2, 2] * per_m, -self.window[3, 2] * per_m
        return a, self.window[2, 3] - a * room_m, c, self.window[3, 3] - c * room_m


def view_camera(region: bpy.types.Region, region_data: bpy.types.RegionView3D, unit_m: float) -> ViewCamera:
    """The camera of a 3D view as it is drawn now: perspective, orthographic, or through a camera object."""
    window = np.array(region_data.window_matrix, dtype=np.float64)
    view = np.array(region_data.view_matrix, dtype=np.float64)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = view[:3, :3], view[:3, 3] * unit_m
    size, orthographic = (region.width, region.height), bool(window[3, 3] == 1.0)
    whole = pinhole_from(window, camera_from_world, size, unit_m, orthographic=orthographic)
    return ViewCamera(whole, window, unit_m)


# ---- new cameras: wrist and fingertips inside the picture, with some air ---------------------------------------------

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
