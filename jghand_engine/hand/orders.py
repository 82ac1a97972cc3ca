"""The orders in which other people list the joints of a hand, and the test that catches a wrong one.

A wrong order is silent: every joint still maps exactly, only the skin is ruined. Therefore joints that come from
outside pass `check_order` and `check_hand_size`, which look at bone lengths only. Source: METHOD 2.1.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Any

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import FINGERS, JOINT_COUNT, PARENTS

# ---- plausibility of joints ----
# index..pinky: metacarpal at least this times the proximal phalanx (anatomy; a wrong joint order breaks it)
METACARPAL_RATIO_MIN = 1.3
# index..pinky: first phalanx at least this times the second; below 1 because video estimates shorten the pinky's
PHALANX_RATIO_MIN = 0.85
# wrist to middle tip, meters: outside this range the unit is most likely not meters
HAND_LENGTH_MIN_M = 0.06
HAND_LENGTH_MAX_M = 0.40
# path index-middle-ring-pinky knuckle over the direct way: a hand's arch gives 1.05, two swapped fingers 1.6 and more
KNUCKLE_DETOUR_MAX = 1.35
# place of a metacarpal's base on the line wrist to knuckle, which OpenXR lists (0.33 to 0.37 in the rig that the
# template comes from)
OPENXR_METACARPAL_PART = 0.34


class JointOrder(StrEnum):
    """How a source lists its joints. Other common names are understood too: `JointOrder("mediapipe")` is STANDARD."""

    LEVEL = "level"
    STANDARD = "standard"
    INTERHAND = "interhand"
    MANO16_TIPS = "mano16_tips"
    OPENXR = "openxr"

    @classmethod
    def _missing_(cls, value: object) -> JointOrder | None:
        return _OTHER_NAMES.get(str(value).lower())

    @classmethod
    def parse(cls, name: str) -> JointOrder:
        """The order called `name`; InputError lists the known names."""
        try:
            return cls(name)
        except ValueError as error:
            known = ", ".join([*cls, *_OTHER_NAMES])
            raise InputError("joint order", wanted=f"one of {known}", came=repr(name)) from error


_OTHER_NAMES = {
    "openpose": JointOrder.STANDARD,
    "mediapipe": JointOrder.STANDARD,
    "freihand": JointOrder.STANDARD,
    "mano21": JointOrder.STANDARD,
    "webxr": JointOrder.OPENXR,
}

# _FROM[order][k] is the place of level joint k in that order; J_level = J_foreign[_FROM]
_FROM = {
    JointOrder.LEVEL: tuple(range(JOINT_COUNT)),
    # wrist, then each finger base to tip
    JointOrder.STANDARD: (0, 1, 5, 9, 13, 17, 2, 6, 10, 14, 18, 3, 7, 11, 15, 19, 4, 8, 12, 16, 20),
    # one hand of InterHand2.6M: each finger tip to base, the wrist last
    JointOrder.INTERHAND: (20, 3, 7, 11, 15, 19, 2, 6, 10, 14, 18, 1, 5, 9, 13, 17, 0, 4, 8, 12, 16),
    # MANO's 16 joints (index, middle, pinky, ring, thumb) and then the five tips from the thumb on
    JointOrder.MANO16_TIPS: (0, 13, 1, 4, 10, 7, 14, 2, 5, 11, 8, 15, 3, 6, 12, 9, 16, 17, 18, 19, 20),
    # 26 joints of OpenXR: palm, wrist, thumb 4, then metacarpal base and four joints per finger
    JointOrder.OPENXR: (1, 2, 7, 12, 17, 22, 3, 8, 13, 18, 23, 4, 9, 14, 19, 24, 5, 10, 15, 20, 25),
}
# for arrays of indices: place of level joint k in the standard order, and the level joint at each standard place
STANDARD_OF_LEVEL = np.array(_FROM[JointOrder.STANDARD])
LEVEL_OF_STANDARD = np.argsort(STANDARD_OF_LEVEL)
for _table in (STANDARD_OF_LEVEL, LEVEL_OF_STANDARD):
    _table.setflags(write=False)
_OPENXR_COUNT = 26
_OPENXR_PALM = 0
# place of the metacarpal base of index..pinky in OpenXR
_OPENXR_METACARPALS = (6, 11, 16, 21)


def joint_count(order: JointOrder) -> int:
    """How many joints a hand has in `order` (OpenXR: 26; WebXR's 25 without the palm are read as well)."""
    return _OPENXR_COUNT if order is JointOrder.OPENXR else JOINT_COUNT


def check_joint_shape(joints: Any, order: JointOrder = JointOrder.LEVEL) -> None:
    """Raises InputError unless `joints`, of numpy or torch, is (..., n, 3) with the n of `order`; says what another n
    looks like."""
    shape = tuple(joints.shape)
    if len(shape) < 2 or shape[-1] != 3:
        raise InputError("joints", wanted=f"shape (..., {joint_count(order)}, 3)", came=str(shape))
    came = shape[-2]
    if came == joint_count(order) or (order is JointOrder.OPENXR and came == _OPENXR_COUNT - 1):
        return
    remedy = {
        2 * JOINT_COUNT: "This looks like the two hands of InterHand2.6M: give 0..20 as the right, 21..41 as the left.",
        JOINT_COUNT - 1: "One joint is missing; a hand is the wrist, four joints of each finger, tips included.",
        16: "This looks like MANO's 16 joints without finger tips: append the five tips and name it mano16_tips.",
        _OPENXR_COUNT: "This looks like OpenXR: name the order openxr.",
        _OPENXR_COUNT - 1: "This looks like WebXR: name the order webxr.",
        JOINT_COUNT: f"21 joints are not {order}: name the order that the file has.",
    }.get(came, "")
    raise InputError("joints", wanted=f"{joint_count(order)} joints ({order} order)", came=f"{came}", remedy=remedy)


def to_level(joints: np.ndarray, order: JointOrder) -> np.ndarray:
    """(..., n, 3) joints in `order` -> (..., 21, 3) in level order; same unit. Nothing is computed.

    OpenXR's palm and metacarpal joints are dropped. InputError for another number of joints.
    """
    check_joint_shape(joints, order)
    if joints.shape[-2] == _OPENXR_COUNT - 1:
        return joints[..., [place - 1 for place in _FROM[order]], :]
    return joints[..., list(_FROM[order]), :]


def from_level(joints: np.ndarray, order: JointOrder) -> np.ndarray:
    """(..., 21, 3) joints in level order -> (..., n, 3) in `order`; same unit.

    To OpenXR five joints that JGHand does not have are **estimated** on the lines from the wrist to the knuckles:
    the metacarpal bases at a fixed part of the line, the palm in the middle of the middle metacarpal. The other 21
    are exact, so that `to_level(from_level(j, openxr), openxr)` is `j` itself.
    """
    check_joint_shape(joints)
    if order is not JointOrder.OPENXR:
        return joints[..., [_FROM[order].index(place) for place in range(JOINT_COUNT)], :]
    wrist, knuckles = joints[..., :1, :], joints[..., 2:6, :]
    bases = wrist + OPENXR_METACARPAL_PART * (knuckles - wrist)
    palm = 0.5 * (bases[..., 1:2, :] + knuckles[..., 1:2, :])
    # the 21 joints, the palm and the four bases, then one pick that sorts them
    parts = [joints, palm, bases]
    place_of = {place: k for k, place in enumerate((*_FROM[order], _OPENXR_PALM, *_OPENXR_METACARPALS))}
    return np.concatenate(parts, axis=-2)[..., [place_of[place] for place in range(_OPENXR_COUNT)], :]


def bone_lengths(joints: np.ndarray) -> np.ndarray:
    """(..., 21, 3) level order -> (..., 20) lengths of bones 1..20, same unit."""
    # absurd numbers of a damaged file become infinite, and are refused as lengths
    with np.errstate(over="ignore"):
        return np.linalg.norm(joints[..., 1:, :] - joints[..., PARENTS[1:], :], axis=-1)


def implausibilities(joints: np.ndarray) -> list[str]:
    """What is wrong with the bone lengths of (F, 21, 3) or (21, 3) level-order joints, as sentences; [] for a hand.

    Medians over the frames; any unit. NaN frames are ignored.
    """
    frames = np.asarray(joints, dtype=np.float64).reshape(-1, JOINT_COUNT, 3)
    frames = frames[np.isfinite(frames).all(axis=(1, 2))]
    if not len(frames):
        raise InputError("joints", wanted="at least one frame with all 21 joints", came="none")
    length = np.median(bone_lengths(frames), axis=0)
    metacarpal, proximal, middle = length[0:5], length[5:10], length[10:15]
    wrong = []
    for finger in range(1, 5):
        name = FINGERS[finger]
        if metacarpal[finger] < METACARPAL_RATIO_MIN * proximal[finger]:
            wrong.append(f"the metacarpal of the {name} finger is hardly longer than its first phalanx")
        if proximal[finger] < PHALANX_RATIO_MIN * middle[finger]:
            wrong.append(f"the second phalanx of the {name} finger is longer than its first")
    if length[0] > metacarpal[1:].min():
        wrong.append("the thumb's first bone is longer than a metacarpal of another finger")
    knuckles = frames[:, 2:6]
    with np.errstate(over="ignore"):
        along = np.median(np.linalg.norm(np.diff(knuckles, axis=1), axis=-1).sum(axis=1))
        across = np.median(np.linalg.norm(knuckles[:, 3] - knuckles[:, 0], axis=-1))
    if along > KNUCKLE_DETOUR_MAX * across:
        wrong.append("the knuckles index, middle, ring, pinky do not follow one another")
    return wrong


def guess_order(joints: np.ndarray) -> JointOrder | None:
    """The order in which (F, n, 3) or (n, 3) joints look like a hand, or None. Of several the one with the shortest
    bones: a wrong order connects joints that are far apart."""
    fitting: dict[JointOrder, float] = {}
    for order in JointOrder:
        count = joints.shape[-2]
        if count != joint_count(order) and not (order is JointOrder.OPENXR and count == _OPENXR_COUNT - 1):
            continue
        level = to_level(joints, order)
        if not implausibilities(level):
            fitting[order] = float(np.nanmedian(bone_lengths(level).sum(axis=-1)))
    return min(fitting, key=lambda order: fitting[order]) if fitting else None


def check_order(joints: np.ndarray, order: JointOrder = JointOrder.LEVEL) -> None:
    """Raises InputError when level-order joints that were read as `order` cannot be a hand.

    joints: (F, 21, 3) or (21, 3) in level order, any unit. The error names the order that they look like.
    """
    wrong = implausibilities(joints)
    if not wrong:
        return
    listed = from_level(joints, order)
    if order is JointOrder.OPENXR:
        # the estimated joints are no evidence: look at the 21 alone
        listed = joints
    likely = guess_order(listed)
    wanted = "bone lengths of a hand"
    came = f"{wrong[0]}{f' and {len(wrong) - 1} more' if len(wrong) > 1 else ''}"
    if likely is None or likely is order:
        remedy = "They look like no order that JGHand knows: check the order, the hand and the source."
    else:
        remedy = f"They look like the order '{likely}': name that one."
    raise InputError(f"joints read in {order} order", wanted=wanted, came=came, remedy=remedy)


METERS_PER_UNIT = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_UNIT_NAMES = {"m": "meters", "cm": "centimeters", "mm": "millimeters"}


def hand_length(joints: np.ndarray) -> float:
    """Median length of the chain wrist to middle tip of (..., 21, 3) level-order joints: the same in every pose."""
    chain = joints[..., [0, 3, 8, 13, 18], :].reshape(-1, 5, 3)
    with np.errstate(over="ignore"):
        lengths = np.linalg.norm(np.diff(chain, axis=1), axis=-1).sum(axis=1)
    lengths = lengths[np.isfinite(lengths)]
    if not len(lengths):
        raise InputError("joints", wanted="at least one frame with a whole middle finger", came="none")
    return float(np.median(lengths))


def check_hand_size(joints_m: np.ndarray, unit: str = "m") -> None:
    """Raises InputError when the hand is no hand's size; says which unit it looks like.

    joints_m: (..., 21, 3) level order, meters after conversion from the declared `unit`.
    """
    length = hand_length(joints_m)
    if HAND_LENGTH_MIN_M <= length <= HAND_LENGTH_MAX_M:
        return
    given = length / METERS_PER_UNIT[unit]
    likely = [
        name for name, scale in METERS_PER_UNIT.items() if HAND_LENGTH_MIN_M <= given * scale <= HAND_LENGTH_MAX_M
    ]
    if likely:
        remedy = f"It looks like {_UNIT_NAMES[likely[0]]}: name the unit {likely[0]}, or convert it."
    else:
        remedy = "Check the unit, or scale the hand to its real size."
    raise InputError(
        f"hand given in {_UNIT_NAMES[unit]}",
        wanted=f"{HAND_LENGTH_MIN_M:g} to {HAND_LENGTH_MAX_M:g} m from wrist to middle tip",
        came=f"{length:.4g} m",
        remedy=remedy,
    )
