"""The test that every loader runs on the joints it has read: a wrong order or unit is silent, and ruins the skin."""

from __future__ import annotations

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import (
    METERS_PER_UNIT,
    JointOrder,
    check_order,
    hand_length,
)
from jghand_engine.limits import HAND_LENGTH_MAX_M, HAND_LENGTH_MIN_M

# mean bend of the fingers' middle joints away from the palm, as a sine, from which it must be the other hand
CURL_MIN = 0.1


def check_joints(joints_m: np.ndarray, order: JointOrder, unit: str, source: str) -> None:
    """Raises InputError when the joints of a data set cannot be a hand. METHOD 2.1, on medians over the poses.

    joints_m: (P, 21, 3) level order, meters, NaN where not known · order, unit: as the data set's layout has them ·
    source: the file to name. Poses with missing joints are ignored; without any whole one nothing can be said.
    """
    whole = joints_m[np.isfinite(joints_m).all(axis=(1, 2))]
    if not len(whole):
        return
    length_m = hand_length(whole)
    if not HAND_LENGTH_MIN_M <= length_m <= HAND_LENGTH_MAX_M:
        raise InputError(
            f"joints in {source}",
            wanted=f"a hand of {HAND_LENGTH_MIN_M:g} to {HAND_LENGTH_MAX_M:g} m, in {unit}",
            came=f"{length_m:.3g} m from wrist to middle tip",
            remedy=_unit_remedy(length_m, unit),
        )
    try:
        check_order(whole, order)
    except InputError as error:
        raise InputError(
            f"joints in {source} ({error.thing})", wanted=error.wanted, came=error.came, remedy=error.remedy
        ) from error


def curl_towards_palm(joints_m: np.ndarray, handedness: Handedness) -> float | None:
    """Mean bend of index..pinky at the middle joint towards the palm, as a sine, -1..1; None without a whole pose.

    joints_m: (P, 21, 3) level order. These joints bend one way only, about the line of the knuckles, so that a clearly
    negative value is the other hand.
    """
    whole = joints_m[np.isfinite(joints_m).all(axis=(1, 2))]
    if not len(whole):
        return None
    knuckles = _unit(whole[:, 2] - whole[:, 5])
    knuckles = knuckles if handedness is Handedness.RIGHT else -knuckles
    proximal, middle = (_unit(whole[:, end] - whole[:, start]) for start, end in ((_MCP, _PIP), (_PIP, _DIP)))
    return float((np.cross(proximal, middle) * knuckles[:, None]).sum(axis=-1).mean())


_MCP, _PIP, _DIP = slice(2, 6), slice(7, 11), slice(12, 16)


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def _unit_remedy(length_m: float, unit: str) -> str:
    for name, meters in METERS_PER_UNIT.items():
        likely_m = length_m / METERS_PER_UNIT[unit] * meters
        if HAND_LENGTH_MIN_M <= likely_m <= HAND_LENGTH_MAX_M:
            return f"They look like {name}; this layout has {unit}: convert them, or take the original file."
    return "Take the original file, or scale the hand to its real size."
