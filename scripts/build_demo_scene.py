# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later) and bpy (GPL), so it is under the GPL too: blender_addon/LICENSE.
"""Makes a .blend file with a rigged hand that moves and cameras that look at it.

    .envs/blender/bin/python scripts/build_demo_scene.py --motion MOTION.npz --out hand.blend

Runs in a Python that has bpy. MOTION.npz (or .json, .csv) is what `jghand` writes: joints_m (frames, 21, 3), order,
unit, fps and handedness. The cameras come from a JSON file of `scripts/demo_job.py`, all of one size and with square
pixels, {name: {width, height, fx, fy, cx, cy, camera_from_world}}, or are two, CamPalm and CamSide, that show the whole
hand over the whole motion. The scene is in meters, its first frame is 1, and what is +y in the motion is up, +z, in
Blender.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import bpy  # pyright: ignore[reportMissingImports]

    from blender_addon.core.view import Pinhole
    from blender_addon.hand.motion_files import MotionFile

ROOT = Path(__file__).resolve().parents[1]
BAD_INPUT = 2
FIRST_FRAME = 1


def main(arguments: list[str] | None = None) -> int:
    options = parser().parse_args(arguments)
    if any(importlib.util.find_spec(name) is None for name in ("numpy", "bpy")):
        return failed("This needs a Python with bpy: run it with .envs/blender/bin/python.")
    sys.path.insert(0, str(ROOT))
    from blender_addon.errors import JGHandFailure
    from blender_addon.hand.motion_files import read_motion

    try:
        motion = read_motion(options.motion)
        for note in motion.notes:
            print(f"note: {note}")
        cameras = json.loads(options.cameras.read_text(encoding="utf-8")) if options.cameras else {}
        _build_registered(motion, cameras, options)
    except JGHandFailure as failure:
        failed(str(failure))
        return failure.advice.exit_code
    return 0


def parser() -> argparse.ArgumentParser:
    result = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    result.add_argument("--motion", type=Path, required=True, metavar="FILE.npz")
    result.add_argument("--out", type=Path, required=True, metavar="FILE.blend")
    result.add_argument("--cameras", type=Path, metavar="FILE.json", help="default: CamPalm and CamSide")
    result.add_argument("--avatar", default="", help="a .jghand file, or painted; default: built-in")
    result.add_argument("--size", type=size, default=(512, 334), metavar="WIDTHxHEIGHT", help="without --cameras")
    return result


def size(text: str) -> tuple[int, int]:
    width, _, height = text.partition("x")
    if not (width.isdecimal() and height.isdecimal() and int(width) and int(height)):
        raise argparse.ArgumentTypeError(f"{text!r}: wanted WIDTHxHEIGHT, as 512x334")
    return int(width), int(height)


def failed(sentence: str) -> int:
    print(f"build_demo_scene: {sentence}", file=sys.stderr)
    return BAD_INPUT


def add_camera(context: bpy.types.Context, name: str, pinhole: Pinhole) -> bpy.types.Object:
    """A new camera that sees as `pinhole` does: the inverse of `camera.pinhole` in a scene of the pinhole's size."""
    import bpy  # pyright: ignore[reportMissingImports]
    import numpy as np
    from mathutils import Matrix  # pyright: ignore[reportMissingImports]

    from blender_addon.core.view import CLIP_START_M, OPENCV_FROM_BLENDER

    unit_m = context.scene.unit_settings.scale_length
    data = bpy.data.cameras.new(name)
    data.sensor_fit = "HORIZONTAL"
    data.lens = pinhole.fx * data.sensor_width / pinhole.width
    data.shift_x = 0.5 - pinhole.cx / pinhole.width
    # in widths as well: Blender's unit is the fitted side
    data.shift_y = (pinhole.cy - 0.5 * pinhole.height) / pinhole.width
    data.clip_start = CLIP_START_M / unit_m
    camera = bpy.data.objects.new(name, data)
    world_from_camera = np.linalg.inv(pinhole.camera_from_world) @ OPENCV_FROM_BLENDER
    world_from_camera[:3, 3] /= unit_m
    camera.matrix_world = Matrix(world_from_camera)
    context.scene.collection.objects.link(camera)
    return camera


def _build_registered(motion: MotionFile, cameras: dict[str, dict], options: argparse.Namespace) -> None:
    """Builds with the extension's engine and properties, which are saved with the file."""
    from blender_addon import registration

    registration.register()
    try:
        build(motion, cameras, options)
    finally:
        registration.unregister()


def build(motion: MotionFile, cameras: dict[str, dict], options: argparse.Namespace) -> None:
    """Makes the scene in memory and saves it, compressed."""
    import bpy  # pyright: ignore[reportMissingImports]
    from mathutils import Matrix  # pyright: ignore[reportMissingImports]

    from blender_addon.core import posing, view
    from blender_addon.errors import JGHandFailure
    from blender_addon.hand import armature
    from blender_addon.hand import motion as motions
    from blender_addon.render import camera

    joints_m = motion.joints_m
    bpy.ops.wm.read_factory_settings(use_empty=True)
    context = bpy.context
    scene = context.scene
    scene.render.fps = max(1, round(motion.fps))
    scene.render.fps_base = scene.render.fps / motion.fps
    scene.frame_start, scene.frame_end = FIRST_FRAME, FIRST_FRAME + len(joints_m) - 1
    scene.render.engine = "JGHAND"
    scene.render.film_transparent = True
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.dither_intensity = 0.0  # the engine's own pictures have none
    scene.view_settings.view_transform = "Standard"  # the hand is a photograph: AgX would change its colors
    rest = posing.rest_joints_m(motion.handedness, joints_m)
    hand = armature.build_armature(context, f"Hand {motion.handedness}", rest, motion.handedness)
    hand.jghand.avatar = options.avatar
    motions.key_motion(hand, joints_m, scene, range(FIRST_FRAME, FIRST_FRAME + len(joints_m)))
    # in motions +y is up, in Blender +z
    world_from_motion = view.LIGHT_FROM_WORLD.T
    hand.matrix_world = Matrix(world_from_motion)
    camera.set_picture_size(scene.render, *options.size)
    if cameras:
        pinholes = {
            name: view.Pinhole(**{**numbers, "camera_from_world": numbers["camera_from_world"] @ view.LIGHT_FROM_WORLD})
            for name, numbers in cameras.items()
        }
        first = next(iter(pinholes.values()))
        camera.set_picture_size(scene.render, first.width, first.height)
        eyes = [add_camera(context, name, pinhole) for name, pinhole in pinholes.items()]
    else:
        turned_m = joints_m @ world_from_motion[:3, :3].T
        eyes = [camera.add_framing_camera(context, name, turned_m, motion.handedness) for name in camera.SIDES]
    scene.camera = eyes[0]
    scene.frame_set(FIRST_FRAME)
    try:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        bpy.ops.wm.save_as_mainfile(filepath=str(options.out.resolve()), compress=True)
    except (OSError, RuntimeError) as error:
        raise JGHandFailure("cannot_write", f"{options.out}: {error}") from error


if __name__ == "__main__":
    sys.exit(main())
