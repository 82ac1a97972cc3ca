# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand poses with names: turns of the finger bones from the rest pose, the same table for both hands.

`assets/poses.json` holds the right hand, made from the engine's named poses by `scripts/build_pose_table.py`. A left
hand's bones have the mirrored axes (`posing`), so that a turn (w, x, y, z) becomes (w, x, -y, -z).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from ..errors import JGHandFailure
from .joints import LEFT, NAMES, PARENTS
from .posing import check_handedness

TABLE = Path(__file__).resolve().parents[1] / "assets" / "poses.json"
POSE, LETTER = "pose", "letter"
_MIRROR = np.array([1.0, 1.0, -1.0, -1.0])

# Catalogs of the library: identities must never change, or assets lose their place. Made once at random.
CATALOGS = {
    ("right", POSE): ("5d1f8a52-6c07-4b1e-9d0d-0e7a3c1f4b21", "JGHand/Right Hand"),
    ("right", LETTER): ("a3b7c2d4-1f5e-4a69-8c3b-7d2e9f0a1b32", "JGHand/Right Hand/Manual Alphabet"),
    ("left", POSE): ("7e2a9b63-8d18-4c2f-ae1e-1f8b4d2a5c43", "JGHand/Left Hand"),
    ("left", LETTER): ("c4d8e3f5-2a6f-4b7a-9d4c-8e3fa01b2c54", "JGHand/Left Hand/Manual Alphabet"),
}


@dataclass(frozen=True)
class HandPose:
    """turns: bone -> (w, x, y, z) relative to the rest pose in the bone's own axes; 15 bones. kind: POSE or LETTER."""

    name: str
    kind: str
    description: str
    handedness: str
    turns: dict[str, tuple[float, float, float, float]]

    @property
    def title(self) -> str:
        """What the library calls it; both hands lie in one file, so the hand is part of the name."""
        name = self.name if self.kind == LETTER else self.name.replace("_", " ").capitalize()
        return f"{name} ({self.handedness})"

    @property
    def quaternions(self) -> np.ndarray:
        """(21, 4) in the standard order, the unit quaternion where the pose says nothing."""
        result = np.tile([1.0, 0.0, 0.0, 0.0], (len(NAMES), 1))
        for bone, turn in self.turns.items():
            result[NAMES.index(bone)] = turn
        return result


def all_poses(handedness: str) -> tuple[HandPose, ...]:
    """Every pose of the table for one hand. Raises JGHandFailure: not_a_hand, bad_file (a broken installation)."""
    check_handedness(handedness)
    mirror = _MIRROR if handedness == LEFT else np.ones(4)
    return tuple(
        HandPose(
            entry["name"],
            entry["kind"],
            entry["description"],
            handedness,
            {bone: _quaternion(mirror * turn) for bone, turn in entry["bones"].items()},
        )
        for entry in _entries()
    )


def _quaternion(wxyz: np.ndarray) -> tuple[float, float, float, float]:
    w, x, y, z = map(float, wxyz)
    return w, x, y, z


def pose_named(name: str, handedness: str) -> HandPose:
    """One pose; JGHandFailure (no_pose) lists the names."""
    poses = {pose.name: pose for pose in all_poses(handedness)}
    if name not in poses:
        raise JGHandFailure("no_pose", f"{name!r}; there are {', '.join(poses)}")
    return poses[name]


def posed_joints(rest: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """(21, 4, 4) rest matrices and (21, 4) turns -> (21, 3) joints, as Blender poses the bones."""
    pose = np.empty((len(NAMES), 4, 4))
    for place, parent in enumerate(PARENTS):
        turn = np.eye(4)
        turn[:3, :3] = _rotation(quaternions[place])
        above = rest[place] if parent < 0 else pose[parent] @ np.linalg.inv(rest[parent]) @ rest[place]
        pose[place] = above @ turn
    return pose[:, :3, 3]


@cache
def _entries() -> list[dict]:
    try:
        return json.loads(TABLE.read_text(encoding="utf-8"))["poses"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise JGHandFailure("bad_file", f"{TABLE}: {error}") from error


def _rotation(quaternion: np.ndarray) -> np.ndarray:
    """(w, x, y, z), nearly of unit length -> (3, 3)."""
    w, x, y, z = quaternion / np.linalg.norm(quaternion)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
