"""Hand shapes of the American manual alphabet, in the angles of `anatomy`.

Shapes only: which way the palm faces, and the movements of J and Z, belong to the wrist. Letters that differ by that
alone share a shape and an entry: G and Q, H and U, I and J, K and P; Z is drawn with the shape of `point`. The angles
were set by eye against descriptions of the alphabet; they are the shapes of a canonical hand, not measurements.
"""

from __future__ import annotations

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.anatomy import CONTACTS, POSES_DEG, ArticulatedHand, Contact

_Finger = tuple[float, float, float, float]
_INDEX: _Finger = (86, 0, 106, 66)
_MIDDLE: _Finger = (88, 0, 109, 67)
_RING: _Finger = (88, 0, 108, 66)
_PINKY: _Finger = (86, 0, 104, 64)

# angles of five fingers, thumb first, degrees
LETTERS_DEG: dict[str, tuple[_Finger, ...]] = {
    "A": ((-6, -12, 4, -4), _INDEX, _MIDDLE, _RING, _PINKY),
    "B": ((38, -8, 34, 30), (0, -6, 0, 0), (0, 0, 0, 0), (0, -7, 0, 0), (0, -13, 0, 0)),
    "C": ((18, 30, 12, 18), (28, -4, 52, 32), (30, 0, 54, 33), (30, -4, 52, 32), (28, -6, 50, 30)),
    "D": ((26, 16, 24, 28), (2, 0, 4, 2), (58, 0, 62, 36), (62, -4, 64, 38), (64, -6, 62, 36)),
    "E": ((34, -6, 44, 50), (34, -4, 108, 72), (36, 0, 108, 74), (36, -4, 108, 72), (34, -6, 104, 70)),
    "F": ((24, 12, 18, 30), (52, 0, 56, 34), (4, 0, 6, 4), (3, 4, 6, 4), (2, 12, 6, 4)),
    "G": ((6, -12, 2, 0), (4, 0, 4, 2), _MIDDLE, _RING, _PINKY),
    "I": ((22, -15, 46, 44), _INDEX, _MIDDLE, _RING, (2, 4, 4, 2)),
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
    "X": ((22, -15, 46, 44), (8, 0, 88, 56), _MIDDLE, _RING, _PINKY),
    "Y": POSES_DEG["call"],
}
# as in `anatomy.CONTACTS`: where the thumb's tip meets a finger (1 index .. 4 pinky)
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
# letters with the same shape, and the one under which it stands
SAME_SHAPE = {"H": "U", "J": "I", "P": "K", "Q": "G"}


def letter_angles(letter: str, hand: ArticulatedHand) -> np.ndarray:
    """(5, 4) angles of a letter on a hand, degrees, solved for contact where the thumb touches; InputError lists the
    letters."""
    shape = SAME_SHAPE.get(letter, letter)
    if shape not in LETTERS_DEG:
        raise InputError("letter", wanted=f"one of {', '.join(sorted({*LETTERS_DEG, *SAME_SHAPE}))}", came=repr(letter))
    angles = np.array(LETTERS_DEG[shape], dtype=np.float64)
    return hand.touching(angles, *LETTER_CONTACTS[shape]) if shape in LETTER_CONTACTS else angles
