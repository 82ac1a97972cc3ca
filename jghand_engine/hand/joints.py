"""The 21 joints of a hand: names, parents, levels, handedness, and the orders in which other people list them.

Inside the engine joints are in **level order**: the wrist, the five first joints (thumb CMC, index..pinky MCP), the
five second joints, the five third joints, the five tips. Bone i (1..20) is the segment from parent(i) to joint i.
Files, the wire, USD and the command line use the **standard order** (finger by finger, base to tip), which is also
that of OpenPose, MediaPipe and the reordered MANO. A wrong order is silent in the joints and ruins the skin, so
`check_order` looks at the bone lengths. Source: METHOD 2.1.
"""

from __future__ import annotations

from enum import StrEnum

from ..errors import InputError

FINGERS = ("thumb", "index", "middle", "ring", "pinky")
JOINT_COUNT = 21
BONE_COUNT = 20

LEVEL_NAMES = ("wrist", *(f"{finger}{level}" for level in (1, 2, 3, 4) for finger in FINGERS))
STANDARD_NAMES = ("wrist", *(f"{finger}{level}" for finger in FINGERS for level in (1, 2, 3, 4)))

# parent of every joint in level order; the wrist has none
PARENTS = (-1, 0, 0, 0, 0, 0, *range(1, 16))


class Handedness(StrEnum):
    """Which hand. Always chosen, never guessed: a flat hand looks the same mirrored."""

    RIGHT = "right"
    LEFT = "left"

    @property
    def other(self) -> Handedness:
        """The hand of the other side."""
        return Handedness.LEFT if self is Handedness.RIGHT else Handedness.RIGHT

    @classmethod
    def _missing_(cls, value: object) -> Handedness:
        """Whoever reads a handedness says the same when it is none."""
        raise InputError("handedness", wanted=" or ".join(cls), came=repr(value)[:200])
