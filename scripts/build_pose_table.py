# SPDX-License-Identifier: GPL-3.0-or-later
# This script imports blender_addon (GPL-3.0-or-later), so it is under the GPL too: blender_addon/LICENSE.
"""Writes the poses of the Blender extension's library from the engine's named poses and the manual alphabet.

    .envs/engine/bin/python scripts/build_pose_table.py

Writes blender_addon/assets/poses.json: for the right hand, the turn of every finger bone from the armature's rest pose,
and how far the knuckles of index to pinky move, as parts of their distances from the wrist.
Run it again when a pose changes; a test fails until that is done. `scripts/build_pose_library.py` makes Blender's pose
assets of it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT))

from blender_addon.core import posing
from blender_addon.core.joints import NAMES, PARENTS, RIGHT, TIPS, WRIST
from blender_addon.core.poses import NamedPose
from jghand_engine.files import writing
from jghand_engine.hand.kinematics import ArchingHand
from jghand_engine.hand.orders import JointOrder, from_level, to_level
from jghand_engine.hand.poses import (
    LETTER_CONTACTS,
    LETTERS_DEG,
    POSES_DEG,
    angles_on,
)
from jghand_engine.hand.rotations import quaternion_rotation

TABLE = ROOT / "blender_addon" / "assets" / "poses.json"
# digits of a quaternion: a tip of 20 cm is then right to a few micrometers
DIGITS = 5
# first bones of index to pinky
KNUCKLES = (5, 9, 13, 17)
# letters with the same shape, and the one under which it stands
SAME_SHAPE = {"H": "U", "J": "I", "P": "K", "Q": "G"}


def main() -> None:
    with writing(TABLE) as part:
        part.write_text(as_text(pose_table()), encoding="utf-8")
    print(f"wrote {TABLE.relative_to(ROOT)}")


def pose_table() -> dict:
    """The content of the table."""
    rest_m = posing.rest_joints_m(RIGHT)
    hand = ArchingHand(to_level(rest_m, JointOrder.STANDARD))
    poses = {name: ("pose", "", angles_on(hand, name)) for name in POSES_DEG}
    for letter in LETTERS_DEG:
        same = " and ".join(sorted(other for other, shape in SAME_SHAPE.items() if shape == letter))
        title = f"Hand shape of {letter}{f', also of {same},' if same else ''} in the American manual alphabet"
        poses[f"ASL {letter}"] = ("letter", title, letter_angles(letter, hand))
    joints = from_level(hand.joints(np.stack([angles for *_, angles in poses.values()])), JointOrder.STANDARD)
    keys = posing.bone_keys(joints, posing.rest_matrices(rest_m, RIGHT), RIGHT, still_wrist=True)
    ways = keys.location[:, KNUCKLES] / np.linalg.norm(rest_m[list(KNUCKLES)], axis=-1, keepdims=True)
    return {
        "format": "jghand poses",
        "version": 1,
        "poses": [
            {"name": name, "kind": kind, "description": text, "knuckles": _knuckles(way), "bones": _bones(turn)}
            for (name, (kind, text, _)), turn, way in zip(poses.items(), keys.quaternion, ways, strict=True)
        ],
    }


def letter_angles(letter: str, hand: ArchingHand) -> np.ndarray:
    """(5, 4) angles of a letter on a hand, degrees, solved for contact where the thumb touches."""
    shape = SAME_SHAPE.get(letter, letter)
    angles = np.array(LETTERS_DEG[shape], dtype=np.float64)
    return hand.touching(angles, *LETTER_CONTACTS[shape]) if shape in LETTER_CONTACTS else angles


def as_text(table: dict) -> str:
    """JSON with one line per bone, so that a change of a pose reads as one."""
    poses = []
    for pose in table["poses"]:
        bones = ",\n".join(f'   "{name}": {json.dumps(turn)}' for name, turn in pose["bones"].items())
        head = ", ".join(f'"{key}": {json.dumps(pose[key])}' for key in ("name", "kind", "description", "knuckles"))
        poses.append(f'  {{{head}, "bones": {{\n{bones}}}}}')
    listed = ",\n".join(poses)
    return f'{{"format": "{table["format"]}", "version": {table["version"]}, "poses": [\n{listed}\n]}}\n'


def joints_of(pose: NamedPose) -> np.ndarray:
    """(21, 3) meters: a hand in a pose of the table, as Blender poses the bones."""
    rest_m = posing.rest_joints_m(pose.handedness)
    rest = posing.rest_matrices(rest_m, pose.handedness)
    posed = np.empty((len(NAMES), 4, 4))
    for place, parent in enumerate(PARENTS):
        turn = np.eye(4)
        wxyz = np.array(pose.turns.get(NAMES[place], (1.0, 0.0, 0.0, 0.0)))
        turn[:3, :3] = quaternion_rotation(wxyz / np.linalg.norm(wxyz))
        turn[:3, 3] = np.linalg.norm(rest_m[place]) * np.array(pose.knuckles.get(NAMES[place], (0.0, 0.0, 0.0)))
        above = rest[place] if parent < 0 else posed[parent] @ np.linalg.inv(rest[parent]) @ rest[place]
        posed[place] = above @ turn
    return posed[:, :3, 3]


def _bones(turns: np.ndarray) -> dict[str, list[float]]:
    """(21, 4) w, x, y, z -> those of the 15 bones that turn, w positive."""
    moving = [place for place in range(len(NAMES)) if place != WRIST and place not in TIPS]
    signed = turns * np.where(turns[:, :1] < 0, -1.0, 1.0)
    return {NAMES[place]: _rounded(signed[place]) for place in moving}


def _knuckles(ways: np.ndarray) -> dict[str, list[float]]:
    """(4, 3) -> those of the bones that move."""
    return {NAMES[place]: _rounded(way) for place, way in zip(KNUCKLES, ways, strict=True)}


def _rounded(numbers: np.ndarray) -> list[float]:
    return [round(float(number), DIGITS) + 0.0 for number in numbers]


if __name__ == "__main__":
    main()
