"""Where on the hand a point of the skin lies: palm or back, along which bone, near which joint.

Everything is in the template's canonical frame: wrist at the origin, +y to the middle MCP, +x to the index side, +z out
of the palm, meters. Joints are in level order.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.hand.joints import JOINT_COUNT, PARENTS
from jghand_engine.template.surface import unit

# opposite to the normal of the built-in template's thumb nail: where the thumb's pad is, canonical frame
THUMB_PALMAR = np.array([-0.93, 0.26, 0.27])
OUT_OF_PALM = np.array([0.0, 0.0, 1.0])
THUMB_METACARPAL, THUMB_PROXIMAL, THUMB_DISTAL, THUMB_TIP = 1, 6, 11, 16
# the two bones at a PIP and at a DIP joint of a usual index finger, meters; the first DIP joint
USUAL_BONES_M = (0.049, 0.045)
FIRST_DIP = 11
# n . palmar over which the skin of the palm turns into that of the back
SIDE_BLEND = 0.45


@dataclass(frozen=True)
class SkinPoints:
    """Points on the canonical skin.

    position_m:   (N, 3) meters
    normal:       (N, 3) outward unit normals
    bone_weights: (N, 21) rows sum to 1
    nail:         (N,) 0..1, how far the point lies on a nail
    """

    position_m: np.ndarray
    normal: np.ndarray
    bone_weights: np.ndarray
    nail: np.ndarray

    def __len__(self) -> int:
        return len(self.position_m)


@dataclass(frozen=True)
class Landmarks:
    """Directions of a canonical hand.

    joints_m: (21, 3) meters; axis: (21, 3) unit direction of bone i, from parent(i) to joint i, row 0 that of bone 3;
    palmar: (21, 3) unit directions, perpendicular to the bone, to which it flexes; lateral: axis x palmar, (21, 3).
    """

    joints_m: np.ndarray
    axis: np.ndarray
    palmar: np.ndarray
    lateral: np.ndarray

    @classmethod
    def of(cls, joints_m: np.ndarray) -> Landmarks:
        """joints_m (21, 3) meters, level order, canonical frame, right hand."""
        bones = np.array([joints_m[3], *(joints_m[i] - joints_m[PARENTS[i]] for i in range(1, JOINT_COUNT))])
        axis = unit(bones)
        palmar = np.tile(OUT_OF_PALM, (JOINT_COUNT, 1))
        palmar[[THUMB_PROXIMAL, THUMB_DISTAL, THUMB_TIP]] = THUMB_PALMAR
        palmar[THUMB_METACARPAL] = OUT_OF_PALM + 0.5 * THUMB_PALMAR
        palmar = unit(palmar - (palmar * axis).sum(1, keepdims=True) * axis)
        return cls(joints_m, axis, palmar, np.cross(axis, palmar))

    def palm_side(self, points: SkinPoints) -> np.ndarray:
        """(N,) -1 where the skin faces away from the flexion side of its bone (back), +1 towards it (palm)."""
        palmar = unit(points.bone_weights @ self.palmar)
        return (points.normal * palmar).sum(1)

    def joint_scale(self, joint: int) -> float:
        """Size of a finger at one of its joints 6..15, relative to an index finger: from the lengths of its bones."""
        length_m = np.linalg.norm(self.joints_m[joint + 5] - self.joints_m[joint])
        length_m += np.linalg.norm(self.joints_m[joint] - self.joints_m[joint - 5])
        usual_m = USUAL_BONES_M[joint >= FIRST_DIP]
        return float(np.clip(length_m / usual_m, 0.6, 1.1))

    def hinge_axis(self, joint: int) -> np.ndarray:
        """(3,) the direction of the finger at `joint`: between its two bones."""
        child = joint + 5
        return self.axis[joint] if child >= JOINT_COUNT else unit(self.axis[joint] + self.axis[child])


def palm_share(side: np.ndarray) -> np.ndarray:
    """(N,) 0 on the back, 1 on the palm, smooth at the edge of the hand."""
    return smoothstep(-SIDE_BLEND, SIDE_BLEND, side)


def smoothstep(low: float, high: float, x: np.ndarray) -> np.ndarray:
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def bump(x: np.ndarray, width: float | np.ndarray) -> np.ndarray:
    """exp(-x^2 / 2 width^2)."""
    return np.exp(-0.5 * (x / width) ** 2)


def noise(position_m: np.ndarray, cell_m: float, seed: int) -> np.ndarray:
    """(N,) smooth noise of about zero mean and unit spread, features of about `cell_m` meters, the same every run."""
    lattice = np.random.default_rng(seed).normal(size=(32, 32, 32))
    q = position_m / cell_m
    low = np.floor(q).astype(int)
    t = q - low
    t = t * t * (3 - 2 * t)
    total = np.zeros(len(position_m))
    for corner in np.ndindex(2, 2, 2):
        share = np.where(np.array(corner) == 1, t, 1 - t).prod(1)
        i, j, k = ((low + corner) % 32).T
        total += share * lattice[i, j, k]
    return 1.6 * total
