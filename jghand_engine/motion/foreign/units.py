"""Unit and joint order where a file does not say them: recognized from the hand itself, and told."""

from __future__ import annotations

import numpy as np

from jghand_engine import limits
from jghand_engine.errors import InputError
from jghand_engine.hand.orders import METERS_PER_UNIT, JointOrder, check_joint_shape, guess_order, hand_length

_NAMES = {"m": "metres", "cm": "centimeters", "mm": "millimeters"}


def recognized_order(joints: np.ndarray, source: str) -> tuple[JointOrder, str]:
    """The order in which (F, n, 3) joints look like a hand, and a sentence. InputError when they look like none."""
    count = joints.shape[-2]
    if count in (25, 26):
        return JointOrder.OPENXR, f"{count} joints are taken for those of OpenXR; --order says otherwise."
    if count != 21:
        check_joint_shape(joints, JointOrder.STANDARD)
    whole = joints[np.isfinite(joints).all(axis=(1, 2))]
    some = whole[:: max(1, len(whole) // limits.RECOGNIZE_FRAMES)]
    likely = guess_order(some) if len(some) else None
    if likely is None:
        raise InputError(
            f"joint order of {source}",
            wanted="joints whose bone lengths tell their order",
            came="joints that look like no order that JGHand knows" if len(some) else "no frame with all joints",
            remedy="Say the order with --order, and --any-proportions for a hand of odd proportions.",
        )
    return likely, f"Its joint order is not said: by the lengths of the bones it is '{likely}'; --order says otherwise."


def recognized_unit(level_joints: np.ndarray, source: str) -> tuple[float, str]:
    """Meters per unit of (F, 21, 3) level-order joints, and a sentence. InputError when no unit makes it a hand."""
    length = hand_length(level_joints)
    for name, meters in METERS_PER_UNIT.items():
        if limits.HAND_LENGTH_MIN_M <= length * meters <= limits.HAND_LENGTH_MAX_M:
            return meters, (
                f"Its unit is not said: {length:.3g} from the wrist to the middle finger's tip look like "
                f"{_NAMES[name]}; --unit says otherwise."
            )
    raise InputError(
        f"unit of {source}",
        wanted="a hand of 60 to 400 mm in meters, centimeters or millimeters",
        came=f"{length:.4g} from the wrist to the middle finger's tip",
        remedy="Say how long the hand is with --hand-length, in millimeters (180 is usual).",
    )
