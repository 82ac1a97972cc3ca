"""Cameras that show a whole motion from a named side: upright, nothing cut off, the hand as large as fits.

The directions are those of the hand itself (averaged over the motion), so that a capture in any frame comes out
upright. Hand axes: side = towards the index side, up = wrist to middle knuckle, out = out of the palm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import LEVEL_NAMES, Handedness
from jghand_engine.render.camera import Camera

# focal length over the longer edge of the image: a long lens, which does not make near fingers look swollen
FOCAL = 2.2
# part of the image that the hand may fill
FILL = 0.94
# how far the skin reaches beyond a joint and, with the cut, beyond the wrist, meters, for a palm (wrist to middle
# knuckle) of the length PALM_M; measured on the built-in template
SKIN_M, WRIST_M, PALM_M = 0.012, 0.034, 0.0885
# length of a mean of unit vectors below which it is no direction
DIRECTION_MIN = 0.2

WRIST, INDEX, MIDDLE, PINKY = (LEVEL_NAMES.index(name) for name in ("wrist", "index1", "middle1", "pinky1"))


@dataclass(frozen=True)
class View:
    """to_eye, up: directions in hand axes (side, up, out)."""

    to_eye: tuple[float, float, float]
    up: tuple[float, float, float]


# name on the command line -> where the camera stands
VIEWS: dict[str, View] = {
    "front": View((0, 0, 1), (0, 1, 0)),
    "back": View((0, 0, -1), (0, 1, 0)),
    "side": View((1, 0, 0), (0, 1, 0)),
    "outside": View((-1, 0, 0), (0, 1, 0)),
    "top": View((0, 1, 0), (0, 0, -1)),
    "quarter": View((0.62, 0.22, 0.75), (0, 1, 0)),
    "quarter-back": View((0.62, 0.22, -0.75), (0, 1, 0)),
}


def hand_axes(joints_m: np.ndarray, handedness: Handedness) -> np.ndarray:
    """(F, 21, 3) level-order joints -> (3, 3), columns side, up, out: unit vectors, averaged over the frames.

    A hand that turns all the way round has no average; then the first frame decides. For a left hand the columns are
    left-handed, because `side` follows the index finger. Raises InputError when the palm has no plane.
    """
    for frames in (joints_m, joints_m[:1]):
        up, out = _palm(frames, handedness)
        if up is not None and out is not None:
            side = np.cross(up, out) if handedness is Handedness.RIGHT else np.cross(out, up)
            return np.stack([side, up, out], 1)
    raise InputError("hand", wanted="a palm with a plane", came="wrist and knuckles on one line")


def _palm(joints_m: np.ndarray, handedness: Handedness) -> tuple[np.ndarray | None, np.ndarray | None]:
    """Mean unit direction wrist to middle knuckle, and mean palm normal perpendicular to it; None where undefined."""
    along = joints_m[:, MIDDLE] - joints_m[:, WRIST]
    across = joints_m[:, INDEX] - joints_m[:, PINKY]
    up = _mean_direction(along)
    if up is None:
        return None, None
    normal = np.cross(across, along) if handedness is Handedness.RIGHT else np.cross(along, across)
    out = _mean_direction(normal)
    if out is None:
        return up, None
    out = out - up * (out @ up)
    length = np.linalg.norm(out)
    return up, out / length if length > DIRECTION_MIN else None


def _mean_direction(vectors: np.ndarray) -> np.ndarray | None:
    """Unit mean of the directions of (F, 3) vectors; None when they cancel out or have no length."""
    lengths = np.linalg.norm(vectors, axis=-1, keepdims=True)
    mean = (vectors / np.where(lengths > 0, lengths, 1.0)).mean(0)
    length = np.linalg.norm(mean)
    return mean / length if length > DIRECTION_MIN else None


def framing_camera(joints_m: np.ndarray, handedness: Handedness, view: str, *, width: int, height: int) -> Camera:
    """A camera that shows (F, 21, 3) level-order joints, meters, with the skin around them, in all frames.

    view: a key of VIEWS, else InputError.
    """
    if view not in VIEWS:
        raise InputError("camera", wanted=" | ".join(VIEWS), came=view)
    axes = hand_axes(joints_m, handedness)
    to_eye = axes @ np.asarray(VIEWS[view].to_eye, float)
    to_eye /= np.linalg.norm(to_eye)
    up = axes @ np.asarray(VIEWS[view].up, float)
    right = np.cross(up, to_eye)
    right /= np.linalg.norm(right)
    up = np.cross(to_eye, right)
    points = joints_m.reshape(-1, 3)
    radius = np.tile(skin_radii_m(joints_m), len(joints_m))
    basis = np.stack([right, up, to_eye])
    x, y, toward = (points @ basis.T).T
    center = np.array([(np.min(v - radius) + np.max(v + radius)) / 2 for v in (x, y, toward)])
    focal_px = FOCAL * max(width, height)
    # a sphere of radius r at distance D - d lies inside the half edge h when f (|x| + r) <= h (D - d - r)
    distance = max(
        float(np.max(toward - center[2] + radius + focal_px * (np.abs(v - middle) + radius) / half))
        for v, middle, half in (
            (x, center[0], width / 2 * FILL),
            (y, center[1], height / 2 * FILL),
        )
    )
    target = center @ basis
    eye = target + to_eye * distance
    return Camera.looking_at(eye, target, up, width=width, height=height, focal_px=focal_px)


def skin_radii_m(joints_m: np.ndarray) -> np.ndarray:
    """(21,) how far the skin reaches beyond each joint, scaled with the hand."""
    palm = np.median(np.linalg.norm(joints_m[:, MIDDLE] - joints_m[:, WRIST], axis=-1))
    radii = np.full(joints_m.shape[1], SKIN_M)
    radii[WRIST] = WRIST_M
    return radii * palm / PALM_M
