"""Poses of the hand that have a name and the shapes of the American manual alphabet, as angles of a hand.

Angles are those of `hand.kinematics`, degrees, thumb first. They were set by eye: the shapes of a canonical hand, not
measurements. Where fingers touch they are solved for each hand. Blender's extension has a copy, see `hand.canonical`.
"""

from __future__ import annotations

import numpy as np

from ..errors import InputError
from .kinematics import NEIGHBORS, RANGES_DEG, ArticulatedHand, Contact

_Finger = tuple[float, float, float, float]
# fingers of a fist, bent into the palm and opened for each hand; they turn so that neighbors touch, within 2 mm on all
# hands that captures show, where the palm arches, and on a hand whose skin is known as that wants it (`Fist`). And the
# thumb that rests on them
_INDEX: _Finger = (86, 9, 106, 66)
_MIDDLE: _Finger = (88, 0, 109, 67)
_RING: _Finger = (88, 1, 108, 66)
_PINKY: _Finger = (86, 16, 104, 64)
_FIST = np.array((_INDEX, _MIDDLE, _RING, _PINKY))
_RESTING: _Finger = (24, -14, 50, 30)

# angles of five fingers, thumb first
POSES_DEG: dict[str, tuple[_Finger, ...]] = {
    "open": ((0, 0, 0, 0), (4, 0, 8, 4), (6, 0, 8, 4), (6, 0, 8, 4), (6, 0, 8, 4)),
    "flat": ((2, -13, 0, 0), (0, -6, 0, 0), (0, 0, 0, 0), (0, -7, 0, 0), (0, -13, 0, 0)),
    "spread": ((-10, 18, -5, -5), (-3, 16, 2, 0), (-2, 0, 2, 0), (-3, 14, 2, 0), (-3, 22, 2, 0)),
    "relaxed": ((10, 5, 10, 12), (22, 0, 36, 18), (28, 0, 38, 19), (31, 0, 42, 20), (33, 3, 42, 22)),
    "fist": (_RESTING, _INDEX, _MIDDLE, _RING, _PINKY),
    "point": (_RESTING, (4, 0, 6, 4), _MIDDLE, _RING, _PINKY),
    "victory": ((27, -14, 46, 40), (4, 11, 6, 4), (4, -9, 6, 4), _RING, _PINKY),
    "three": ((34, -12, 46, 42), (4, 10, 5, 3), (4, 0, 5, 3), (4, 9, 5, 3), _PINKY),
    "four": ((36, -12, 46, 44), (4, 10, 5, 3), (4, 0, 5, 3), (4, 8, 5, 3), (4, 16, 5, 3)),
    "thumb_up": ((-12, 14, -6, -12), _INDEX, _MIDDLE, _RING, _PINKY),
    "pinch": ((24, 12, 18, 28), (50, 0, 54, 32), (34, 0, 36, 21), (32, 0, 34, 18), (30, 3, 32, 18)),
    "ok": ((24, 12, 18, 30), (52, 0, 56, 34), (16, 0, 17, 9), (11, 4, 14, 6), (6, 10, 12, 6)),
    "rock": (_RESTING, (4, 4, 6, 4), _MIDDLE, _RING, (4, 8, 6, 4)),
    "call": ((-8, 24, -5, -8), _INDEX, _MIDDLE, _RING, (2, 18, 6, 4)),
    "claw": ((5, 12, 25, 40), (-4, 8, 84, 52), (-4, 0, 84, 54), (-4, 6, 84, 52), (-4, 12, 80, 50)),
    "grasp": ((22, 16, 20, 25), (54, 4, 52, 30), (56, 0, 52, 32), (58, 3, 52, 30), (58, 8, 50, 30)),
    "table": ((8, 5, 5, 5), (84, 0, 8, 4), (86, 0, 8, 4), (86, 0, 8, 4), (84, 0, 8, 4)),
}


# poses in which the thumb's tip touches a finger (1 index .. 4 pinky): the angles are solved for each hand
CONTACTS = {
    "pinch": (Contact.TIP, 1),
    "ok": (Contact.TIP, 1),
    "fist": (Contact.REST, 2),
    "point": (Contact.REST, 2),
    "victory": (Contact.REST, 3),
    "three": (Contact.REST, 4),
    "rock": (Contact.REST, 2),
}

# Shapes only: which way the palm faces, and the movements of J and Z, belong to the wrist. Letters that differ by that
# alone share a shape and an entry: G and Q, H and U, I and J, K and P; Z is drawn with the shape of `point`.
LETTERS_DEG: dict[str, tuple[_Finger, ...]] = {
    "A": ((-6, -12, 4, -4), _INDEX, _MIDDLE, _RING, _PINKY),
    "B": ((38, -8, 34, 30), (0, -6, 0, 0), (0, 0, 0, 0), (0, -7, 0, 0), (0, -13, 0, 0)),
    "C": ((18, 30, 12, 18), (28, -4, 52, 32), (30, 0, 54, 33), (30, -4, 52, 32), (28, -6, 50, 30)),
    "D": ((26, 16, 24, 28), (2, 0, 4, 2), (58, 0, 62, 36), (62, -4, 64, 38), (64, -6, 62, 36)),
    "E": ((34, -6, 44, 50), (34, -4, 108, 72), (36, 0, 108, 74), (36, -4, 108, 72), (34, -6, 104, 70)),
    "F": ((24, 12, 18, 30), (52, 0, 56, 34), (4, 0, 6, 4), (3, 4, 6, 4), (2, 12, 6, 4)),
    "G": ((6, -12, 2, 0), (4, 0, 4, 2), _MIDDLE, _RING, _PINKY),
    "I": (_RESTING, _INDEX, _MIDDLE, _RING, (2, 4, 4, 2)),
    "K": ((8, 6, 6, 4), (2, 6, 4, 2), (48, 0, 8, 4), _RING, _PINKY),
    "L": ((-14, 6, -6, -8), (2, 0, 4, 2), _MIDDLE, _RING, _PINKY),
    "M": ((45, -6, 34, 10), (64, -4, 82, 40), (66, 0, 84, 40), (68, -4, 84, 40), _PINKY),
    "N": ((40, -6, 24, 8), (64, -4, 82, 40), (66, 0, 84, 40), _RING, _PINKY),
    "O": ((24, 14, 16, 26), (48, -4, 54, 34), (50, 0, 56, 35), (50, -4, 54, 34), (48, -6, 52, 32)),
    "R": ((27, -14, 46, 40), (0, -14, 2, 0), (14, 17, 8, 4), _RING, _PINKY),
    "S": POSES_DEG["fist"],
    "T": ((20, -14, 16, 10), (74, 2, 84, 44), _MIDDLE, _RING, _PINKY),
    "U": ((27, -14, 46, 40), (2, -6, 4, 2), (2, 3, 4, 2), _RING, _PINKY),
    "V": POSES_DEG["victory"],
    "W": POSES_DEG["three"],
    "X": (_RESTING, (8, 0, 88, 56), _MIDDLE, _RING, _PINKY),
    "Y": POSES_DEG["call"],
}
# letters with the same shape, and the one under which it stands
SAME_SHAPE = {"H": "U", "J": "I", "P": "K", "Q": "G"}
# as in CONTACTS
LETTER_CONTACTS = {
    "D": (Contact.TIP, 2),
    "F": (Contact.TIP, 1),
    "I": (Contact.REST, 2),
    "O": (Contact.TIP, 1),
    "R": (Contact.REST, 3),
    "S": CONTACTS["fist"],
    "U": (Contact.REST, 3),
    "V": CONTACTS["victory"],
    "W": CONTACTS["three"],
    "X": (Contact.REST, 2),
}


def pose_names() -> tuple[str, ...]:
    """The poses that have a name."""
    return tuple(POSES_DEG)


def named_angles(name: str) -> np.ndarray:
    """(5, 4) angles of a named pose, degrees; InputError lists the names."""
    if name not in POSES_DEG:
        raise InputError("pose", wanted=f"one of {', '.join(POSES_DEG)}", came=repr(name))
    return np.array(POSES_DEG[name], dtype=np.float64)


def angles_on(hand: ArticulatedHand, name: str) -> np.ndarray:
    """(5, 4) angles of a named pose on this hand, degrees: the table's, solved for contact where fingers touch their
    neighbors, the palm or the thumb."""
    return _closed(hand, named_angles(name), CONTACTS.get(name))


def letter_angles_on(hand: ArticulatedHand, letter: str) -> np.ndarray:
    """The same of a letter, A to Y."""
    shape = SAME_SHAPE.get(letter, letter)
    return _closed(hand, np.array(LETTERS_DEG[shape], dtype=np.float64), LETTER_CONTACTS.get(shape))


def _side_by_side(angles: np.ndarray, turns_deg: tuple[float, ...]) -> np.ndarray:
    """The angles with index, ring and pinky turned where they and their neighbors are those of a fist; they go with
    neighbors that turn."""
    bent, turned = [False, *(angles[1:] == _FIST).all(1)], angles.copy()
    for (finger, neighbor), turn_deg in zip(NEIGHBORS, turns_deg, strict=True):
        if bent[finger] and bent[neighbor]:
            turned[finger, 1] += turn_deg + turned[neighbor, 1] - angles[neighbor, 1]
    return turned


def _closed(hand: ArticulatedHand, angles: np.ndarray, contact: tuple[Contact, int] | None) -> np.ndarray:
    angles = _side_by_side(angles, hand.fist.turns_deg)
    eased = hand.eased(np.clip(angles, RANGES_DEG[..., 0], RANGES_DEG[..., 1]))
    return hand.touching(eased, *contact) if contact else eased
