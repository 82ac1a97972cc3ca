# SPDX-License-Identifier: GPL-3.0-or-later
"""The finger controls as numbers: where they stand, what a turn of them does, and how far joints go.

A finger control turns like its finger: about its x axis it curls the finger, about its z axis it spreads it, positive
away from the middle finger (the middle finger itself: to the thumb's side), on both hands. To make both signs so, the
axes of some controls point backwards; the shapes drawn for them do not. The control of the hand does the same to all
fingers: fist and splay. Angles of joints are anatomical: flexion 0 is a straight finger, so what the rest pose is bent
already counts. Sources: METHOD 4.1 and DATA 8 for the ranges; BLENDER 6 for the axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .joints import FINGERS, NAMES, RIGHT, WRIST

# turn of a control that means a full curl, how far it goes the other way, and the turn that means a full spread
CURL_FULL_DEG, CURL_BACK_DEG, SPREAD_FULL_DEG = 90.0, 20.0, 25.0
# what a full splay spreads of each finger, thumb first: the engine's pose "spread", the little finger counts one
SPLAY_PARTS = (0.8, 0.75, 0.0, 0.65, 1.0)
# lowest and highest angle of a joint, degrees: flexion and spread of the first bone, flexion of the second and third;
# thumb (from its rest), fingers (from straight). The same as the engine's `hand.kinematics.RANGES_DEG`; a test compares
JOINT_RANGES_DEG = (
    ((-15.0, 45.0), (-15.0, 35.0), (-10.0, 55.0), (-15.0, 85.0)),
    ((-25.0, 92.0), (-22.0, 25.0), (-5.0, 112.0), (-8.0, 82.0)),
)
# the middle and last joints are hinges, with some play (METHOD 4.1); thumb, fingers. The thumb's axes here follow its
# nail and lie up to 30 degrees from the engine's, so that its hinges seem to bend sideways too, as a pinky's does that
# leans on its neighbor in a fist, and its first joint goes a little further: by what the engine's named poses need
# (31.6, 17.0 and 4.1)
SIDEWAYS_RANGE_DEG = (32.0, 18.0)
THUMB_PLAY_DEG = 5.0
# the first bones bend farther against the wrist's bone by what the palm arches under them: the engine's
# `hand.kinematics.SINK_DEG`, thumb first
SINK_DEG = (0.0, 0.3, 0.0, 2.7, 5.5)
# turn of a bone about itself: passive play of a knuckle, and what swings about two axes have of it (assumed)
TWIST_RANGE_DEG = 30.0

HAND_CONTROL = "control_hand"
FINGER_CONTROLS = tuple(f"control_{finger}" for finger in FINGERS)
TIP_CONTROLS = tuple(f"tip_{finger}" for finger in FINGERS)
CONTROLS = (HAND_CONTROL, *FINGER_CONTROLS, *TIP_CONTROLS)
# names of the constraints on the 21 bones, in the order in which they act: spread and curl by a control, and how far
# knuckles go with the curl; what has such a name is ours
OF_HAND = "JGHand Splay", "JGHand Fist", "JGHand Fist Palm"
OF_FINGER = "JGHand Spread", "JGHand Curl", "JGHand Curl Palm"
LIMIT, TIP = "JGHand Limit", "JGHand Tip"
RULES = (*OF_HAND, *OF_FINGER, LIMIT, TIP)

_BACKWARDS = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True)
class JointRange:
    """How far a bone turns about its own axes from the rest pose: (low, high) about x, y and z, radians. A hinge
    turns about x alone but for some play."""

    bone: str
    hinge: bool
    x: tuple[float, float]
    y: tuple[float, float]
    z: tuple[float, float]


def channel(control: str) -> str:
    """The channel of a control that does something; the others are locked."""
    return "location" if control in TIP_CONTROLS else "rotation_euler"


def moving_bones(finger: int) -> tuple[str, str, str]:
    first = 1 + 4 * finger
    return NAMES[first], NAMES[first + 1], NAMES[first + 2]


def control_matrices(rest: np.ndarray, handedness: str) -> dict[str, np.ndarray]:
    """(21, 4, 4) rest matrices -> the matrix (4, 4) of every control at rest, in the same space and unit."""
    result = {HAND_CONTROL: rest[WRIST].copy()}
    for finger, name in enumerate(FINGER_CONTROLS):
        result[name] = rest[1 + 4 * finger].copy()
        if spread_sign(finger, handedness) < 0:
            result[name][:3, :3] = result[name][:3, :3] @ _BACKWARDS
    for finger, name in enumerate(TIP_CONTROLS):
        result[name] = rest[4 + 4 * finger].copy()
    return result


def spread_sign(finger: int, handedness: str) -> float:
    """The sign of the turn about a finger bone's z axis that leads away from the middle finger."""
    to_thumb = finger <= FINGERS.index("middle")
    return -1.0 if to_thumb == (handedness == RIGHT) else 1.0


def joint_ranges(rest: np.ndarray, handedness: str) -> tuple[JointRange, ...]:
    """The ranges of the 15 bones that turn, as turns from the rest pose, which always lies within.

    rest: (21, 4, 4).
    """
    result = []
    flexions = rest_flexions(rest)
    twist = np.radians(TWIST_RANGE_DEG)
    for finger in range(len(FINGERS)):
        table = np.radians(JOINT_RANGES_DEG[0 if finger == 0 else 1])
        sideways = np.radians(SIDEWAYS_RANGE_DEG[0 if finger == 0 else 1])
        sign = spread_sign(finger, handedness)
        for level, bone in enumerate(moving_bones(finger)):
            play = np.radians(THUMB_PLAY_DEG) if finger == level == 0 else 0.0
            sink = np.radians(SINK_DEG[finger]) if level == 0 else 0.0
            low, high = table[0 if level == 0 else level + 1] - flexions[finger, level] + (-play, play + sink)
            spread = sorted(sign * table[1]) if level == 0 else (-sideways, sideways)
            result.append(
                JointRange(
                    bone,
                    level > 0,
                    (float(min(low, 0.0)), float(max(high, 0.0))),
                    (-float(twist), float(twist)),
                    (float(spread[0]), float(spread[1])),
                )
            )
    return tuple(result)


def rest_flexions(rest: np.ndarray) -> np.ndarray:
    """(5, 3) how far each moving bone is bent at rest against its parent bone (the first one: against the palm).

    The thumb's are zero: its angles are counted from its rest already.
    """
    result = np.zeros((len(FINGERS), 3))
    for finger in range(1, len(FINGERS)):
        for level in range(3):
            place = 1 + 4 * finger + level
            parent = WRIST if level == 0 else place - 1
            along = rest[parent, :3, :3].T @ rest[place, :3, 1]
            result[finger, level] = np.arcsin(np.clip(along[2], -1.0, 1.0))
    return result
