"""Hand shapes of finger spelling (American Sign Language), as angles; the shapes, not the orientations of the hand.

Angles as in `jghand_engine.hand.anatomy`: degrees, thumb first, per finger (MCP flexion, MCP abduction, PIP, DIP), of
the thumb (CMC flexion, CMC abduction, MCP, IP). Letters that differ only by the direction of the hand appear
once; J and Z are movements. Typed from descriptions of the alphabet: alike enough to vary the
pictures, not to teach spelling.
"""

from __future__ import annotations

from jghand_engine.hand.anatomy import Contact

_CURLED = (86, 0, 104, 64)
_STRAIGHT = (2, -2, 4, 3)

LETTERS_DEG: dict[str, tuple[tuple[float, float, float, float], ...]] = {
    "letter_a": ((-4, -12, 8, 6), _CURLED, _CURLED, _CURLED, _CURLED),
    "letter_b": ((34, -12, 30, 38), _STRAIGHT, _STRAIGHT, _STRAIGHT, _STRAIGHT),
    "letter_c": ((18, 22, 14, 20), (32, 0, 52, 32), (34, 0, 54, 32), (34, 0, 54, 32), (32, 0, 52, 30)),
    "letter_d": ((28, 6, 26, 32), (0, 0, 4, 3), (58, 0, 70, 38), (62, 0, 74, 40), (64, 0, 74, 40)),
    "letter_e": ((32, -10, 44, 46), (46, 0, 104, 62), (48, 0, 106, 62), (50, 0, 104, 62), (50, 0, 100, 60)),
    "letter_f": ((24, 12, 18, 28), (52, 0, 56, 34), (-4, 2, 4, 2), (-4, 8, 4, 2), (-4, 14, 4, 2)),
    "letter_g": ((-6, 4, 6, 8), (60, 0, 8, 4), _CURLED, _CURLED, _CURLED),
    "letter_h": ((22, -10, 40, 40), (58, -4, 6, 4), (58, -2, 6, 4), _CURLED, _CURLED),
    "letter_i": ((20, -14, 44, 42), _CURLED, _CURLED, _CURLED, (-2, 6, 4, 2)),
    "letter_k": ((16, 4, 12, 14), (4, 8, 4, 2), (52, 0, 8, 4), _CURLED, _CURLED),
    "letter_l": ((-14, 20, -8, -8), (0, 0, 2, 2), _CURLED, _CURLED, _CURLED),
    "letter_m": ((40, -14, 40, 34), (72, 0, 84, 46), (74, 0, 84, 46), (76, 0, 84, 46), _CURLED),
    "letter_n": ((34, -14, 40, 34), (72, 0, 84, 46), (74, 0, 84, 46), _CURLED, _CURLED),
    "letter_o": ((26, 14, 20, 30), (50, 0, 58, 36), (52, 0, 60, 36), (54, 0, 60, 36), (54, 0, 58, 34)),
    "letter_r": ((28, -12, 44, 42), (6, -10, 6, 4), (-2, 6, 4, 2), _CURLED, _CURLED),
    "letter_s": ((22, -15, 46, 46), _CURLED, _CURLED, _CURLED, _CURLED),
    "letter_t": ((14, -10, 30, 24), (74, 0, 90, 50), _CURLED, _CURLED, _CURLED),
    "letter_u": ((28, -12, 46, 42), (0, -5, 4, 2), (0, -2, 4, 2), _CURLED, _CURLED),
    "letter_w": ((34, -12, 48, 44), (0, 12, 4, 2), (0, 0, 4, 2), (0, 12, 4, 2), (76, 0, 98, 58)),
    "letter_x": ((22, -15, 46, 44), (12, 0, 88, 52), _CURLED, _CURLED, _CURLED),
    "letter_y": ((-10, 26, -6, -8), _CURLED, _CURLED, _CURLED, (0, 20, 4, 2)),
    "number_7": ((34, 4, 24, 30), (0, 6, 4, 2), (0, 0, 4, 2), (56, 0, 62, 38), (0, 14, 4, 2)),
    "number_8": ((28, 6, 22, 28), (0, 8, 4, 2), (56, 0, 58, 36), (0, 6, 4, 2), (0, 14, 4, 2)),
}

# where the thumb's tip touches: (how, finger 1 index .. 4 pinky)
LETTER_CONTACTS = {
    "letter_d": (Contact.TIP, 2),
    "letter_e": (Contact.REST, 3),
    "letter_f": (Contact.TIP, 1),
    "letter_i": (Contact.REST, 2),
    "letter_o": (Contact.TIP, 1),
    "letter_r": (Contact.REST, 3),
    "letter_s": (Contact.REST, 2),
    "letter_u": (Contact.REST, 3),
    "letter_w": (Contact.TIP, 4),
    "letter_x": (Contact.REST, 2),
    "number_7": (Contact.TIP, 3),
    "number_8": (Contact.TIP, 2),
}
