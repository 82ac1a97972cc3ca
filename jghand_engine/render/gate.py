"""When is the self-shadow worth its time? From the joints alone (METHOD 5.4).

Static creases are painted into the colors; only what a pose brings together needs the pass. The score sums, over
pairs of bones that are not neighbors, how much nearer their capsules are than on the canonical hand. The shadow fades
in with it and is never switched, so nothing pops.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from jghand_engine.avatar.cast_task import Capsules
from jghand_engine.avatar.learned import CAPSULE_RADII_MM, capsules
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT, PARENTS
from jghand_engine.hand.skeleton import Bones
from jghand_engine.native.contract import Z_NEAR_M
from jghand_engine.render.camera import Camera

# radius of influence, meters, and the score over which the pass fades in
GATE_RADIUS_M = 0.060
GATE_LOW = 0.5
GATE_HIGH = 1.0
# hands smaller than this on the image get no shadow pass, px; it fades in up to the second size
SHADOW_HAND_MIN_PX = 64.0
SHADOW_HAND_FULL_PX = 96.0
# hands whose boxes are nearer cast all of their shadow on each other, and those farther apart none, meters: from there
# a hand takes 1 % of what a point of the skin sees
CAST_NEAR_M = 0.10
CAST_FAR_M = 0.30
# samples along each capsule's axis: 5 x 5 distances per pair of bones; penetration is capped (a deep overlap of two
# bones must not hide the others)
GATE_SAMPLES = 5
GATE_PENETRATION_MAX = 1.5

_PARENTS = np.array(PARENTS[1:])  # of the end of bone k + 1, hence its start
_RADII_M = np.array(CAPSULE_RADII_MM) * 1e-3


def _far_pairs() -> tuple[np.ndarray, np.ndarray]:
    """Pairs of bones (0-based) that are not parent and child, and not both metacarpals: no others begin at one joint,
    and in the order of levels no bone begins where a later one ends."""
    first, second = np.triu_indices(BONE_COUNT, 1)
    chained, metacarpals = _PARENTS[second] == first + 1, (_PARENTS[first] == 0) & (_PARENTS[second] == 0)
    keep = ~(chained | metacarpals)
    return first[keep], second[keep]


_FIRST, _SECOND = _far_pairs()
_REACH_M = _RADII_M[_FIRST] + _RADII_M[_SECOND]
_ALONG = np.linspace(0.0, 1.0, GATE_SAMPLES)[:, None, None]


class ShadowGate:
    """canonical_joints_m: (21, 3) level order, meters. Its own score is 0."""

    def __init__(self, canonical_joints_m: np.ndarray) -> None:
        self._canonical = _penetration(np.asarray(canonical_joints_m, np.float64), 1.0)

    def score(self, joints_m: np.ndarray, scale: float = 1.0) -> float:
        """How much closer the bones are than on the canonical hand: 0 and up, the same from every side.

        joints_m: (21, 3) finite, level order, meters, left or right · scale: of the hand, s_g; capsules and the radius
        of influence grow with it.
        """
        return float(np.maximum(_penetration(joints_m, scale) - self._canonical, 0.0).sum())


def contact_between(hands_m: Sequence[np.ndarray]) -> float:
    """The same sum over bones of different hands (21, 3): 0 when they are farther apart than the radius of influence.

    There is no canonical distance between two hands, so nothing is subtracted. Capsules are those of scale 1.
    """
    total = 0.0
    for index, first in enumerate(hands_m):
        for second in hands_m[index + 1 :]:
            a, b = _samples(first, first[0]), _samples(second, first[0])
            gap = np.sqrt(np.maximum(_nearest2(a, b), 0.0)) - (_RADII_M[:, None] + _RADII_M)
            total += float(_closeness(gap).sum())
    return total


def capsules_beside(hands_m: Sequence[np.ndarray], bones: Sequence[Bones]) -> list[Capsules | None]:
    """Per hand (21, 3) the flesh of the others, which casts its shadow on it; None where they are too far away."""
    # a gap is that of both
    parts: dict[tuple[int, int], float] = {}
    for first, second in itertools.combinations(range(len(hands_m)), 2):
        gap_m = gap_between([hands_m[first], hands_m[second]])
        parts[first, second] = parts[second, first] = 1 - smoothstep(gap_m, CAST_NEAR_M, CAST_FAR_M)
    found: list[Capsules | None] = []
    for mine, joints in enumerate(hands_m):
        near = []
        for place, (other, own) in enumerate(zip(hands_m, bones, strict=True)):
            part = parts.get((mine, place), 0.0)
            if part > 0:
                start_m, end_m, radius_m = capsules(other - joints[0], own.scale)
                near.append((start_m, end_m, radius_m, np.full(len(radius_m), part)))
        found.append(Capsules(*map(np.concatenate, zip(*near, strict=True))) if near else None)
    return found


def gap_between(hands_m: Sequence[np.ndarray]) -> float:
    """At least how far, meters, the nearest two of several hands (21, 3) are apart: the gap of the boxes around their
    capsules of scale 1. Infinite for one hand."""
    flesh_m = float(_RADII_M.max())
    boxes = [(hand.min(0) - flesh_m, hand.max(0) + flesh_m) for hand in hands_m]
    gaps = [
        float(np.linalg.norm(np.maximum(np.maximum(low - other_high, other_low - high), 0.0)))
        for index, (low, high) in enumerate(boxes)
        for other_low, other_high in boxes[index + 1 :]
    ]
    return min(gaps, default=float("inf"))


def fade(score: float) -> float:
    """Strength of the shadow, 0..1, by the gate's score."""
    return smoothstep(score, GATE_LOW, GATE_HIGH)


def fade_with_size(size_px: float) -> float:
    """0..1: how much of the shadow the largest hand, of that extent, gets."""
    return smoothstep(size_px, SHADOW_HAND_MIN_PX, SHADOW_HAND_FULL_PX)


def extent_px(joints_px: float, nearest_m: float, camera: Camera) -> float:
    """The longer side of the box around a hand on the image, of that around its joints and the depth of the nearest;
    infinite when the camera is inside the hand."""
    if not nearest_m > Z_NEAR_M:
        return math.inf
    return joints_px + 2e-3 * max(CAPSULE_RADII_MM) * camera.px_per_meter(nearest_m)


def smoothstep(value: float, low: float, high: float) -> float:
    """0 up to `low`, 1 from `high` on, smooth between."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def _penetration(joints_m: np.ndarray, scale: float) -> np.ndarray:
    """(pairs,) clamp(1 - gap / R, 0, max)^2 of every far pair, the gap between capsules sampled 5 x 5."""
    points = _samples(joints_m, joints_m[0])
    gap = np.sqrt(np.maximum(_nearest2(points, points)[_FIRST, _SECOND], 0.0)) / max(scale, 1e-12) - _REACH_M
    return _closeness(gap)


def _closeness(gap_m: np.ndarray) -> np.ndarray:
    inside = np.clip(1.0 - gap_m / GATE_RADIUS_M, 0.0, GATE_PENETRATION_MAX)
    return inside * inside


def _samples(joints_m: np.ndarray, origin_m: np.ndarray) -> np.ndarray:
    """(5 x 20, 3) points along the bones, sample by sample, so that the minima below run over whole rows."""
    start = joints_m[_PARENTS]
    return (start - origin_m + _ALONG * (joints_m[1:JOINT_COUNT] - start)).reshape(-1, 3)


def _nearest2(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(20, 20) least squared distance between the samples of every two bones."""
    distance2 = a @ (-2.0 * b.T)
    distance2 += np.einsum("ij,ij->i", b, b)
    distance2 += np.einsum("ij,ij->i", a, a)[:, None]
    shape = (GATE_SAMPLES, BONE_COUNT, GATE_SAMPLES, BONE_COUNT)
    return distance2.reshape(shape).min(axis=0).min(axis=1)
