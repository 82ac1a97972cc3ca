"""Cameras in files: our own JSON, so that a picture can be repeated or matched, and those that reconstruction programs
read, COLMAP's text model and nerfstudio's transforms.json.

Ours: width, height, fx, fy, cx, cy in pixels and camera_from_world, 4 x 4, meters, OpenCV axes (x right, y down, z
forward). COLMAP has the same: the outer corner of the top-left pixel at (0, 0), maps from world to camera. nerfstudio
has maps from camera to world, and cameras that look along -z with y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.files import make_folder, write_file
from jghand_engine.hand.rotations import quaternions
from jghand_engine.json_files import JsonObject, read_small_json, write_json
from jghand_engine.render.camera import Camera

# the largest number of a camera, pixels or meters: beyond it no picture is meant
CAMERA_NUMBER_MAX = 1e6
COLMAP_FILES = ("cameras.txt", "images.txt", "points3D.txt")
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
NUMBERS = ("width", "height", "fx", "fy", "cx", "cy")


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    """Plain data from which `camera_from_dict` makes the same camera."""
    numbers = {name: getattr(camera, name) for name in NUMBERS}
    return {**numbers, "camera_from_world": camera.camera_from_world.tolist()}


def camera_from_dict(content: Any, thing: str = "camera") -> Camera:
    """The camera of plain data. Raises InputError that names the missing or wrong entry."""
    fields = JsonObject(content, lambda name, wanted, came: _wrong(f"{thing}: {name}", wanted, came))
    width, height, fx, fy, cx, cy = (fields.number(name, -CAMERA_NUMBER_MAX, CAMERA_NUMBER_MAX) for name in NUMBERS)
    for name, pixels in (("width", width), ("height", height)):
        if pixels != int(pixels):
            raise fields.wrong(name, "a whole number of pixels")
    matrix = fields.array("camera_from_world", (4, 4))
    # NaN is not within anything
    outside = matrix[~(np.abs(matrix) <= CAMERA_NUMBER_MAX)]
    if outside.size:
        wanted = f"4 rows of 4 numbers of at most {CAMERA_NUMBER_MAX:g}"
        raise InputError(f"{thing}: camera_from_world", wanted=wanted, came=f"{outside[0]:g}")
    rotation = matrix[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0
    if not rigid or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise InputError(
            f"{thing}: camera_from_world", wanted="a rotation and a translation", came="a scaled or mirrored map"
        )
    return Camera(int(width), int(height), fx, fy, cx, cy, matrix)


def _wrong(name: str, wanted: str, came: object) -> InputError:
    return InputError(name, wanted=wanted, came=repr(came)[:80])


def read_camera(path: Path) -> Camera:
    return camera_from_dict(read_small_json(path), str(path))


def write_colmap(folder: Path | str, names: Sequence[str], camera: Camera) -> Path:
    """Writes cameras.txt, images.txt and an empty points3D.txt into `folder`, which is returned, of pictures (their
    files' names, without blanks, relative to their folder) that one pinhole took."""
    target = make_folder(folder)
    lens = " ".join(map(repr, (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)))
    pose = camera.camera_from_world
    numbers = " ".join(repr(float(value)) for value in (*quaternions(pose[:3, :3]), *pose[:3, 3]))
    # the second line of a picture lists points seen in it: none
    images = [f"{number} {numbers} 1 {name}\n\n" for number, name in enumerate(names, start=1)]
    texts = (
        f"# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy\n1 PINHOLE {lens}\n",
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then its points\n" + "".join(images),
        "# no points: the hand moves\n",
    )
    for name, text in zip(COLMAP_FILES, texts, strict=True):
        write_file(target / name, text)
    return target


def write_transforms(path: Path | str, names: Sequence[str], camera: Camera) -> None:
    """Writes nerfstudio's transforms.json, of such pictures; their names are taken relative to its folder."""
    world_from_camera = np.linalg.inv(camera.camera_from_world) @ OPENGL_FROM_OPENCV
    taken = {
        "w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "transform_matrix": world_from_camera.tolist(),
    }  # fmt: skip
    write_json(path, {"camera_model": "OPENCV", "frames": [{"file_path": name, **taken} for name in names]})
