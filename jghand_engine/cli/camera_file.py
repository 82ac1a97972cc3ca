"""A camera as JSON, so that a picture can be repeated or matched: width, height, fx, fy, cx, cy in pixels and
camera_from_world, 4 x 4, meters, OpenCV axes (x right, y down, z forward)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from jghand_engine.cli.console import read_json
from jghand_engine.errors import InputError
from jghand_engine.limits import CAMERA_NUMBER_MAX
from jghand_engine.render.camera import Camera

NUMBERS = ("width", "height", "fx", "fy", "cx", "cy")


def camera_to_dict(camera: Camera) -> dict[str, Any]:
    """Plain data from which `camera_from_dict` makes the same camera."""
    numbers = {name: getattr(camera, name) for name in NUMBERS}
    return {**numbers, "camera_from_world": camera.camera_from_world.tolist()}


def camera_from_dict(content: Any, thing: str = "camera") -> Camera:
    """The camera of plain data. Raises InputError that names the missing or wrong entry."""
    if not isinstance(content, dict):
        raise InputError(thing, wanted="an object with " + ", ".join(NUMBERS), came=type(content).__name__)
    numbers: dict[str, float] = {}
    for name in NUMBERS:
        value = content.get(name)
        # NaN is not within anything
        if not isinstance(value, int | float) or isinstance(value, bool) or not abs(value) <= CAMERA_NUMBER_MAX:
            wanted = f"a number of pixels of at most {CAMERA_NUMBER_MAX:g}"
            raise InputError(f"{thing}: {name}", wanted=wanted, came=repr(value)[:80])
        numbers[name] = value
    for name in ("width", "height"):
        if numbers[name] != int(numbers[name]):
            raise InputError(f"{thing}: {name}", wanted="a whole number of pixels", came=str(numbers[name]))
    matrix = _matrix(content.get("camera_from_world"), f"{thing}: camera_from_world")
    rotation = matrix[:3, :3]
    rigid = np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-4) and np.linalg.det(rotation) > 0
    if not rigid or not np.allclose(matrix[3], (0, 0, 0, 1)):
        raise InputError(
            f"{thing}: camera_from_world", wanted="a rotation and a translation", came="a scaled or mirrored map"
        )
    width, height = int(numbers["width"]), int(numbers["height"])
    fx, fy, cx, cy = (numbers[name] for name in ("fx", "fy", "cx", "cy"))
    return Camera(width, height, fx, fy, cx, cy, matrix)


def _matrix(content: Any, thing: str) -> np.ndarray:
    """(4, 4) float64. InputError says what came instead."""
    try:
        matrix, came = np.asarray(content, np.float64), ""
    except (TypeError, ValueError, OverflowError):
        matrix, came = np.empty(0), "no rows of numbers"
    # NaN is not within anything
    outside = matrix[~(np.abs(matrix) <= CAMERA_NUMBER_MAX)]
    if matrix.shape != (4, 4):
        came = came or f"numbers of shape {matrix.shape}"
    elif outside.size:
        came = f"{outside[0]:g}"
    if came:
        raise InputError(thing, wanted=f"4 rows of 4 numbers of at most {CAMERA_NUMBER_MAX:g}", came=came)
    return matrix


def read_camera(path: Path) -> Camera:
    """The camera of a JSON file."""
    return camera_from_dict(read_json(path), str(path))
