"""Points in JSON, however a program writes them, as arrays."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.motion.bone_names import NamedHand, hands_among

_MISSING = (math.nan, math.nan, math.nan)
# names under which a joint's position, or the list of joints, may stand
_POSITION = ("position", "pos", "translation", "location", "pose", "transform")
_LISTS = ("landmark", "landmarks", "joints", "points", "keypoints", "positions", "pose")


def point(value: Any) -> tuple[float, float, float]:
    """x, y, z of {"x": …}, [x, y, z, …], {"position": …}; NaN for null. ValueError for anything else."""
    if value is None:
        return _MISSING
    if isinstance(value, Mapping):
        if "x" in value and "y" in value:
            return _numbers(value["x"], value["y"], value.get("z"))
        for name in _POSITION:
            if name in value:
                return point(value[name])
    elif isinstance(value, list | tuple) and len(value) >= 3:
        return _numbers(value[0], value[1], value[2])
    raise ValueError(f"no point: {str(value)[:60]}")


def points(value: Any) -> np.ndarray | None:
    """(n, 3) float64 of a list of points, of x, y, z one after the other, or of either in a list of its own name; None
    where it is neither. Missing points are NaN."""
    if isinstance(value, Mapping):
        inside = next((value[name] for name in _LISTS if name in value), None)
        return None if inside is None else points(inside)
    if not isinstance(value, list) or not value:
        return None
    if all(isinstance(number, int | float) and not isinstance(number, bool) for number in value):
        if len(value) % 3 or len(value) < 3 * JOINT_COUNT:
            return None
        return np.array(value, dtype=np.float64).reshape(-1, 3)
    try:
        return np.array([point(one) for one in value], dtype=np.float64)
    except ValueError:
        return None


def named_points(value: Mapping[str, Any]) -> list[tuple[NamedHand, np.ndarray]]:
    """The hands among points with names, {"wrist": {"position": …}, …}, and (21, 3) joints of each in the standard
    order, NaN where missing."""
    names = [name for name in value if isinstance(name, str)]
    if len(names) < JOINT_COUNT:
        return []
    hands = []
    for hand in _hands_among(tuple(names)):
        joints = [_MISSING if place is None else point(value[names[place]]) for place in hand.bones]
        hands.append((hand, np.array(joints, dtype=np.float64)))
    return hands


@lru_cache(maxsize=8)
def _hands_among(names: tuple[str, ...]) -> tuple[NamedHand, ...]:
    """Frame after frame has the same names, and looking for hands in them takes longer than all the rest."""
    return tuple(hands_among(names)[0])


def _numbers(*values: Any) -> tuple[float, float, float]:
    numbers = tuple(math.nan if value is None else value for value in values)
    if not all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers):
        raise ValueError(f"no numbers: {str(values)[:60]}")
    x, y, z = (float(number) for number in numbers)
    return x, y, z
