"""A camera as JSON, so that a picture can be repeated or matched: width, height, fx, fy, cx, cy in pixels and
camera_from_world, 4 x 4, meters, OpenCV axes (x right, y down, z forward)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.json_files import JsonObject, read_small_json
from jghand_engine.render.camera import Camera

# the largest number of a camera, pixels or meters: beyond it no picture is meant
CAMERA_NUMBER_MAX = 1e6
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
