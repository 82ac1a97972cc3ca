# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand poses with names: turns of the finger bones from the rest pose, and how far knuckles draw together; the same
table for both hands.

`assets/poses.json` holds the right hand, made from the engine's named poses by `scripts/build_pose_table.py`. A left
hand's bones have the mirrored axes (`posing`), so that a turn (w, x, y, z) becomes (w, x, -y, -z) and a way (x, y, z)
becomes (-x, y, z).
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from .joints import LEFT

TABLE = Path(__file__).resolve().parents[1] / "assets" / "poses.json"
# kinds
POSE, LETTER = "pose", "letter"
_TURN_MIRROR, _WAY_MIRROR = np.array([1.0, 1.0, -1.0, -1.0]), np.array([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class NamedPose:
    """A pose of the bones, each in its own axes, relative to the rest pose.

    kind:     POSE or LETTER
    turns:    bone -> (w, x, y, z); 15 bones
    knuckles: first bone of index to pinky -> (x, y, z) that it moves, as parts of its distance from the wrist at rest
    """

    name: str
    kind: str
    description: str
    handedness: str
    turns: dict[str, tuple[float, ...]]
    knuckles: dict[str, tuple[float, ...]]

    @property
    def label(self) -> str:
        """What menus call it."""
        return self.name if self.kind == LETTER else self.name.replace("_", " ").capitalize()

    @property
    def title(self) -> str:
        """What the library calls it; both hands lie in one file, so the hand is part of the name."""
        return f"{self.label} ({self.handedness})"


def all_poses(handedness: str) -> tuple[NamedPose, ...]:
    """Every pose of the table for one hand."""
    turn_mirror, way_mirror = (_TURN_MIRROR, _WAY_MIRROR) if handedness == LEFT else (np.ones(4), np.ones(3))
    return tuple(
        NamedPose(
            entry["name"],
            entry["kind"],
            entry["description"],
            handedness,
            {bone: _numbers(turn_mirror * turn) for bone, turn in entry["bones"].items()},
            {bone: _numbers(way_mirror * way) for bone, way in entry["knuckles"].items()},
        )
        for entry in _entries()
    )


def _numbers(array: np.ndarray) -> tuple[float, ...]:
    return tuple(map(float, array))


def pose_named(name: str, handedness: str) -> NamedPose:
    return next(pose for pose in all_poses(handedness) if pose.name == name)


@cache
def _entries() -> list[dict]:
    return json.loads(TABLE.read_text(encoding="utf-8"))["poses"]
