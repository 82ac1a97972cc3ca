"""Frames in JSON, however a program writes them: their members, times, and points as arrays. All other readers of JSON
look at values through these functions."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT
from jghand_engine.motion.bone_names import NamedHand, hands_among
from jghand_engine.motion.clocks import TIME_NAMES, plain

_MISSING = (math.nan, math.nan, math.nan)
# names under which a joint's position, or the list of joints, may stand
_POSITION = ("position", "pos", "translation", "location", "pose", "transform")
_LISTS = ("landmark", "landmarks", "joints", "points", "keypoints", "positions", "pose")


def by_plain_name(frame: Any) -> dict[str, Any]:
    """The members of a frame by their plain names; {} for one that has none."""
    return {plain(str(key)): value for key, value in frame.items()} if isinstance(frame, Mapping) else {}


def time_in(frame: Mapping[str, Any]) -> float | None:
    """The time among the members of a frame, whose names are `plain`; None without one."""
    times = (frame[name] for name in TIME_NAMES if _is_number(frame.get(name)))
    return next(map(float, times), None)


def points(value: Any) -> np.ndarray | None:
    """(n, 3) float64 of a list of points, of x, y, z one after the other, or of either in a list of its own name; None
    where it is neither. Missing points are NaN."""
    if isinstance(value, Mapping):
        inside = next((value[name] for name in _LISTS if name in value), None)
        return None if inside is None else points(inside)
    if not isinstance(value, list) or not value:
        return None
    if all(map(_is_number, value)):
        if len(value) % 3 or len(value) < 3 * JOINT_COUNT:
            return None
        return np.array(value, dtype=np.float64).reshape(-1, 3)
    try:
        return np.array([_point(one) for one in value], dtype=np.float64)
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
        joints = [_MISSING if place is None else _point(value[names[place]]) for place in hand.bones]
        hands.append((hand, np.array(joints, dtype=np.float64)))
    return hands


@lru_cache(maxsize=8)
def _hands_among(names: tuple[str, ...]) -> tuple[NamedHand, ...]:
    """Frame after frame has the same names, and looking for hands in them takes longer than all the rest."""
    return tuple(hands_among(names)[0])


def _point(value: Any) -> tuple[float, ...]:
    """x, y, z of {"x": …}, [x, y, z, …], {"position": …}; NaN for null. ValueError for anything else."""
    if value is None:
        return _MISSING
    if isinstance(value, Mapping):
        if "x" in value and "y" in value:
            return _point([value["x"], value["y"], value.get("z")])
        inside = next((value[name] for name in _POSITION if name in value), ())
        return _point(inside)
    numbers = [math.nan if number is None else number for number in value[:3]] if isinstance(value, list) else []
    if len(numbers) < 3 or not all(map(_is_number, numbers)):
        raise ValueError(f"no point: {str(value)[:60]}")
    return tuple(map(float, numbers))


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)
