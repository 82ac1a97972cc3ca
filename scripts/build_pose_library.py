# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later) and bpy (GPL), so it is under the GPL too: blender_addon/LICENSE.
"""Makes the asset library of hand poses that the extension ships: blender_addon/assets/poses.

    .envs/blender/bin/python scripts/build_pose_library.py [--out FOLDER] [--engine PYTHON]

Runs in a Python that has bpy 5.0; Blender 4.5 to 5.2 read what it writes. Run it again when a pose changes in
jghand_engine/hand/shapes.py; a test compares the two. The folder gets one .blend file with pose assets for both hands,
solved for the built-in one, with pictures that the engine renders, and Blender's catalog file beside it.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

import bpy
import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from blender_addon.core import poses, posing
from blender_addon.core.controls import FINGER_CONTROLS, HAND_CONTROL
from blender_addon.core.joints import HANDEDNESSES, LEFT, NAMES, RIGHT
from blender_addon.core.poses import NamedPose
from blender_addon.core.view import BUILTIN_AVATAR
from blender_addon.hand import poses as pose_library
from blender_addon.hand.avatar_files import SHIPPED_CARDS
from blender_addon.hand.motion_files import MotionFile, write_motion

# pixels: Blender shows assets at up to 128, and a quarter less than that keeps the file small
PREVIEW_PX = 96
FIST = SHIPPED_CARDS[BUILTIN_AVATAR].fist
# Catalogs of the library: identities must never change, or assets lose their place. Made once at random.
CATALOGS = {
    ("right", "pose"): ("5d1f8a52-6c07-4b1e-9d0d-0e7a3c1f4b21", "JGHand/Right Hand"),
    ("right", poses.LETTER): ("a3b7c2d4-1f5e-4a69-8c3b-7d2e9f0a1b32", "JGHand/Right Hand/Manual Alphabet"),
    ("left", "pose"): ("7e2a9b63-8d18-4c2f-ae1e-1f8b4d2a5c43", "JGHand/Left Hand"),
    ("left", poses.LETTER): ("c4d8e3f5-2a6f-4b7a-9d4c-8e3fa01b2c54", "JGHand/Left Hand/Manual Alphabet"),
}


def rendered_poses(engine: Path) -> dict[str, np.ndarray]:
    """Name of a pose -> (H, W, 4) float32 RGBA of the right hand, bottom row first, as the engine renders it."""
    named = poses.ALL_POSES
    joints_m = np.stack([poses.joints_on(pose.name, posing.rest_joints_m(RIGHT), RIGHT, FIST) for pose in named])
    with tempfile.TemporaryDirectory() as scratch:
        motion, frames = Path(scratch) / "poses.npz", Path(scratch) / "frames"
        write_motion(motion, MotionFile(joints_m, fps=1.0, handedness=RIGHT))
        command = [str(engine), "-m", "jghand_engine", "render", "--motion", str(motion), "--out", str(frames)]
        command += ["--camera", "front", "--size", f"{PREVIEW_PX}x{PREVIEW_PX}", "--keep-bone-lengths"]
        subprocess.run(command, check=True, cwd=ROOT)
        pictures = [_pixels(path) for path in sorted(frames.glob("frame_*.png"))]
    return {pose.name: picture for pose, picture in zip(named, pictures, strict=True)}


def _pixels(path: Path) -> np.ndarray:
    image = bpy.data.images.load(str(path))
    pixels = np.empty(4 * image.size[0] * image.size[1], np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(image.size[1], image.size[0], 4)
    bpy.data.images.remove(image)
    return pixels


def asset_of(pose: NamedPose, side: str, picture: np.ndarray) -> bpy.types.Action:
    """An action of one frame with what the pose says, marked as an asset."""
    action = bpy.data.actions.new(pose.title(side))
    slot = action.slots.new("OBJECT", "Hand")
    bag = action.layers.new("Layer").strips.new(type="KEYFRAME").channelbag(slot, ensure=True)

    def key(bone: str, path: str, index: int, value: float) -> None:
        curve = bag.fcurves.new(f'pose.bones["{bone}"].{path}', index=index)
        curve.group = bag.groups.get(bone) or bag.groups.new(bone)
        curve.keyframe_points.insert(1.0, value)

    rest_m = posing.rest_joints_m(side)
    fingers = poses.pose_on(pose.name, posing.rest_matrices(rest_m, side), side, FIST)
    for bone, turn in fingers.turns.items():
        for index, part in enumerate(turn):
            key(bone, "rotation_quaternion", index, part)
    for bone, way in fingers.knuckles.items():
        for index, part in enumerate(way):
            key(bone, "location", index, part * float(np.linalg.norm(rest_m[NAMES.index(bone)])))
    # a pose is what is seen: controls go back to neutral where there are any
    for bone in (HAND_CONTROL, *FINGER_CONTROLS):
        for index in (0, 2):
            key(bone, "rotation_euler", index, 0.0)
    action.asset_mark()
    data = action.asset_data
    data.catalog_id = CATALOGS[side, pose.kind][0]
    data.description = pose.description or f"{pose.name.replace('_', ' ').capitalize()}, {side} hand"
    data.author = "The JGHand authors"
    data.license = "GPL-3.0-or-later"
    for tag in ("hand", side, *(("ASL",) if pose.kind == poses.LETTER else ())):
        data.tags.new(tag, skip_if_exists=True)
    preview = action.preview_ensure()
    preview.image_size = (picture.shape[1], picture.shape[0])
    preview.image_pixels_float.foreach_set(np.ascontiguousarray(picture).ravel())
    return action


def catalogs() -> str:
    """What Blender's catalog file says."""
    lines = ["# Catalogs of an asset library of Blender", "VERSION 1", ""]
    lines += [f"{identity}:{path}:{path.replace('/', '-')}" for identity, path in CATALOGS.values()]
    return "\n".join(lines) + "\n"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=pose_library.FOLDER, help="the folder of the library")
    engine = ROOT / ".envs" / "engine" / "bin" / "python"
    parser.add_argument("--engine", type=Path, default=engine, help="a Python that has jghand_engine")
    options = parser.parse_args()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    pictures = rendered_poses(options.engine)
    made = set()
    for side in HANDEDNESSES:
        for pose in poses.ALL_POSES:
            picture = pictures[pose.name]
            made.add(asset_of(pose, side, picture[:, ::-1] if side == LEFT else picture))
    out = options.out.resolve()
    out.mkdir(parents=True, exist_ok=True)
    path = out / pose_library.BLEND
    bpy.data.libraries.write(str(path), made, fake_user=True, compress=True)
    (out / pose_library.CATALOG_FILE).write_text(catalogs(), encoding="utf-8")
    print(f"wrote {path} ({path.stat().st_size / 1024:.0f} KiB)")
    return 0


if __name__ == "__main__":
    sys.exit(main())
