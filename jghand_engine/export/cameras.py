"""Cameras in the files that reconstruction programs read: COLMAP's text model and nerfstudio's transforms.json.

COLMAP has our camera: OpenCV axes, the outer corner of the top-left pixel at (0, 0), maps from world to camera.
nerfstudio has maps from camera to world, and cameras that look along -z with y up.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.files import make_folder, write_file
from jghand_engine.hand.rotations import quaternions
from jghand_engine.json_files import write_json
from jghand_engine.render.camera import Camera

COLMAP_FILES = ("cameras.txt", "images.txt", "points3D.txt")
OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True)
class Shot:
    """A picture and what it was taken with. name: of its file, relative to the folder of the pictures"""

    name: str
    camera: Camera


def write_colmap(folder: Path | str, shots: Sequence[Shot]) -> Path:
    """Writes cameras.txt, images.txt and an empty points3D.txt into `folder`, which is returned. Cameras that differ in
    nothing but their place are one. InputError without pictures, for parallel rays, and for names with blanks."""
    _check(shots)
    target = make_folder(folder)
    lenses: dict[str, int] = {}
    images = []
    for number, shot in enumerate(shots, start=1):
        camera = shot.camera
        lens = " ".join(map(repr, (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)))
        pose = camera.camera_from_world
        turn = quaternions(pose[:3, :3])
        numbers = " ".join(repr(float(value)) for value in (*turn, *pose[:3, 3]))
        # the second line of a picture lists points seen in it: none
        images.append(f"{number} {numbers} {lenses.setdefault(lens, len(lenses) + 1)} {shot.name}\n\n")
    cameras = [f"{number} PINHOLE {lens}\n" for lens, number in lenses.items()]
    texts = (
        "# CAMERA_ID, MODEL, WIDTH, HEIGHT, fx, fy, cx, cy\n" + "".join(cameras),
        "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME; then its points\n" + "".join(images),
        "# no points: the hand moves\n",
    )
    for name, text in zip(COLMAP_FILES, texts, strict=True):
        write_file(target / name, text)
    return target


def write_transforms(path: Path | str, shots: Sequence[Shot]) -> None:
    """Writes nerfstudio's transforms.json; names of pictures are taken relative to its folder. InputError without
    pictures, for parallel rays, and for names with blanks."""
    _check(shots)
    write_json(path, {"camera_model": "OPENCV", "frames": [_frame(shot) for shot in shots]})


def _frame(shot: Shot) -> dict[str, Any]:
    camera = shot.camera
    world_from_camera = np.linalg.inv(camera.camera_from_world) @ OPENGL_FROM_OPENCV
    return {
        "file_path": shot.name, "w": camera.width, "h": camera.height,
        "fl_x": camera.fx, "fl_y": camera.fy, "cx": camera.cx, "cy": camera.cy,
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0,
        "transform_matrix": world_from_camera.tolist(),
    }  # fmt: skip


def _check(shots: Sequence[Shot]) -> None:
    if not shots:
        raise InputError("camera file", wanted="at least one picture", came="none")
    for shot in shots:
        if shot.camera.orthographic:
            raise InputError(f"camera of {shot.name}", wanted="a perspective one", came="parallel rays")
        if not shot.name or any(letter.isspace() for letter in shot.name):
            raise InputError("name of a picture in a camera file", wanted="one without blanks", came=repr(shot.name))
