# SPDX-License-Identifier: GPL-3.0-or-later
"""The 21 joints: names, parents, bones, and the hand at rest. The only tables of the extension.

Standard order: the wrist, then thumb, index, middle, ring, pinky, each from the base to the tip. A bone is named after
the joint at its **head**; METHOD's bone i is the segment that *ends* at joint i. Source: DATA 1 and 2, BLENDER 6.
"""

from __future__ import annotations

FINGERS = ("thumb", "index", "middle", "ring", "pinky")
NAMES = ("wrist", *(f"{finger}{level}" for finger in FINGERS for level in (1, 2, 3, 4)))
PARENTS = (-1, *(0 if place % 4 == 0 else place for place in range(20)))
WRIST, INDEX, MIDDLE, RING, PINKY = 0, 5, 9, 13, 17
# the first joint of each finger, where its metacarpal ends
KNUCKLES = (1, INDEX, MIDDLE, RING, PINKY)
# the bone that the wrist hangs on, of a hand whose avatar has a forearm
FOREARM = "forearm"
TIPS = tuple(place for place, name in enumerate(NAMES) if name.endswith("4"))
THUMB = (1, 2, 3, 4)
# the joint at which a bone's tail points: the next one of the finger, the middle MCP for the wrist, none for a tip
TAILS = (MIDDLE, *(-1 if place in TIPS else place + 1 for place in range(1, 21)))

RIGHT, LEFT = "right", "left"
HANDEDNESSES = (RIGHT, LEFT)
OTHER = {RIGHT: LEFT, LEFT: RIGHT}

# where it begins: the elbow of the right hand at rest. The skin of an avatar ends half-way
ELBOW_RIGHT_M = (0.0420, -0.2347, 0.0276)
# The right hand at rest: the joints of the engine's built-in hand, meters; +y wrist to middle MCP, +x to the index
# side, +z out of the palm. Here as well, because a rig is useful without an engine; a test compares the two.
REST_RIGHT_M = (
    (0.000000, 0.000000, 0.000000),
    (0.030365, 0.020858, 0.007114),
    (0.047570, 0.055162, 0.024194),
    (0.057634, 0.073987, 0.036245),
    (0.068384, 0.097342, 0.051000),
    (0.023242, 0.091403, 0.006284),
    (0.025858, 0.120737, 0.009120),
    (0.026920, 0.139263, 0.015779),
    (0.027241, 0.164718, 0.027386),
    (0.000000, 0.088454, 0.000000),
    (-0.007691, 0.124524, 0.009498),
    (-0.011456, 0.149645, 0.017915),
    (-0.015469, 0.171242, 0.028012),
    (-0.018080, 0.082456, -0.000522),
    (-0.030909, 0.115282, 0.007706),
    (-0.039058, 0.138421, 0.018867),
    (-0.045802, 0.155291, 0.025528),
    (-0.035080, 0.071148, 0.006284),
    (-0.047054, 0.094340, 0.012626),
    (-0.053214, 0.107164, 0.017373),
    (-0.060709, 0.122279, 0.025918),
)
