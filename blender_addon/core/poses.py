# SPDX-License-Identifier: GPL-3.0-or-later
"""Hand poses with names, on any hand: turns of its finger bones from the rest pose, and how far knuckles draw together.

Angles, and how fingers close for each hand, are the engine's (`hand.shapes` and `hand.kinematics`, which every package
of the extension carries). Those are of right hands; a left one is posed as its mirror image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from . import kinematics, posing, shapes
from .joints import KNUCKLES, LEFT, NAMES, TIPS, WRIST

# kinds
POSE, LETTER = "pose", "letter"
# the engine's order of the joints: all fingers' first ones, all second ones
_LEVEL = np.array([WRIST, *(first + level for level in range(4) for first in KNUCKLES)])
_MIRROR = np.array([-1.0, 1.0, 1.0])
_LETTER_NAME = "ASL {}"


@dataclass(frozen=True)
class NamedPose:
    """What menus and libraries say of a pose."""

    name: str
    kind: str
    description: str

    @property
    def label(self) -> str:
        """What menus call it."""
        return self.name if self.kind == LETTER else self.name.replace("_", " ").capitalize()

    def title(self, handedness: str) -> str:
        """What the library calls it; both hands lie in one file, so the hand is part of the name."""
        return f"{self.label} ({handedness})"


@dataclass(frozen=True)
class PosedFingers:
    """A pose of the bones of one hand, each in its own axes, relative to the rest pose.

    turns:    bone -> (w, x, y, z); 15 bones
    knuckles: first bone of index to pinky -> (x, y, z) that it moves, as parts of its distance from the wrist at rest
    """

    handedness: str
    turns: dict[str, tuple[float, ...]]
    knuckles: dict[str, tuple[float, ...]]


def _letter(letter: str) -> NamedPose:
    same = " and ".join(sorted(other for other, shape in shapes.SAME_SHAPE.items() if shape == letter))
    title = f"Hand shape of {letter}{f', also of {same},' if same else ''} in the American manual alphabet"
    return NamedPose(_LETTER_NAME.format(letter), LETTER, title)


ALL_POSES = (*(NamedPose(name, POSE, "") for name in shapes.POSES_DEG), *map(_letter, shapes.LETTERS_DEG))
_LETTERS = {_LETTER_NAME.format(letter): letter for letter in shapes.LETTERS_DEG}


def joints_on(name: str, rest: np.ndarray, handedness: str, fist: kinematics.Fist = kinematics.NO_FIST) -> np.ndarray:
    """(21, 3) joints of a pose of the hand with these (21, 3) joints at rest, in their space and unit: fingers are bent
    until they touch the palm, the thumb until it touches them. fist: of its avatar. shapes.InputError: joints that are
    no hand's."""
    mirror = _MIRROR if handedness == LEFT else np.ones(3)
    hand = kinematics.ArchingHand((rest * mirror)[_LEVEL], fist)
    letter = _LETTERS.get(name)
    angles = shapes.angles_on(hand, name) if letter is None else shapes.letter_angles_on(hand, letter)
    return hand.joints(angles[None])[0][np.argsort(_LEVEL)] * mirror


def pose_on(name: str, rest: np.ndarray, handedness: str, fist: kinematics.Fist = kinematics.NO_FIST) -> PosedFingers:
    """A pose of the hand with these (21, 4, 4) rest matrices. fist: of its avatar"""
    try:
        joints = joints_on(name, rest[:, :3, 3], handedness, fist)
    except shapes.InputError:  # somebody bent it out of shape at rest: turned as the built-in hand is
        rest = posing.rest_matrices(posing.rest_joints_m(handedness), handedness)
        joints = joints_on(name, rest[:, :3, 3], handedness, fist)
    keys = posing.bone_keys(joints[None], rest, handedness, still_wrist=True)
    moving = [place for place in range(len(NAMES)) if place != WRIST and place not in TIPS]
    size = np.linalg.norm(rest[:, :3, 3] - rest[WRIST, :3, 3], axis=-1)
    return PosedFingers(
        handedness,
        {NAMES[place]: tuple(map(float, keys.quaternion[0, place])) for place in moving},
        {NAMES[place]: tuple(map(float, keys.location[0, place] / size[place])) for place in KNUCKLES[1:]},
    )
