"""The canonical hand: what the bones of every pose are compared with. METHOD 2.4 and 2.7.

Blender's extension carries a copy of this file, `kinematics` and `shapes`, and of what they import: hence relative
imports, and nothing but NumPy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .joints import JOINT_COUNT, LEVEL_NAMES, PARENTS
from .rotations import unit

# sine between neighboring palm bones below which the palm plane is clamped towards the canonical one (C1)
PALM_CLAMP = 0.02

# ---- a canonical hand is refused when ----
# a bone is shorter than this part of the mean bone
CANONICAL_BONE_MIN = 1e-3
# neighboring palm bones enclose a smaller sine: from 2 PALM_CLAMP on the clamp leaves its palm planes alone
CANONICAL_PALM_SINE_MIN = 2 * PALM_CLAMP
# a joint is nearer than this to the abduction pole, as 1 - |u_y|
CANONICAL_POLE_MIN = 0.02


@dataclass(frozen=True)
class CanonicalHand:
    """What the bones of every pose are compared with; float64, right hand.

    root_m:      (3,) wrist, meters;  joints_m: (21, 3) about the wrist
    length_m:    (20,);  direction: (20, 3) unit
    frames:      (21, 3, 3) the palm's and those of bones 1..20: columns x out of the palm, y the flexion axis, z along
                 the bone
    u:           (15, 3) direction of bones 6..20 in the parent's frame
    swing:       (15, 3, 3) Q(u), the frame of bones 6..20 in the parent's
    palm_normal: (4, 3) of the planes of neighboring palm bones
    """

    root_m: np.ndarray
    joints_m: np.ndarray
    length_m: np.ndarray
    direction: np.ndarray
    frames: np.ndarray
    u: np.ndarray
    swing: np.ndarray
    palm_normal: np.ndarray

    @classmethod
    def build(cls, joints_m: np.ndarray) -> CanonicalHand:
        """From (21, 3) level-order joints of a right hand, meters, with the euler swing.

        InputError for a wrong shape, a non-finite joint, a vanishing bone, collinear palm bones, or a joint at the
        abduction pole (METHOD 2.4).
        """
        # a copy: the caller's array may be read-only, or change later
        joints = np.asarray(joints_m, dtype=np.float64).copy()
        if joints.shape != (JOINT_COUNT, 3) or not np.isfinite(joints).all():
            raise InputError("canonical joints", wanted="a finite (21, 3) array", came=str(joints.shape))
        centered = joints - joints[0]
        bones = centered[1:] - centered[list(PARENTS[1:])]
        length = np.linalg.norm(bones, axis=1)
        if not (length > CANONICAL_BONE_MIN * length.mean()).all():
            name = LEVEL_NAMES[int(length.argmin()) + 1]
            raise InputError("canonical hand", wanted="bones with a length", came=f"none at {name}")
        direction = bones / length[:, None]
        normal = np.cross(direction[:4], direction[1:5])
        sine = np.linalg.norm(normal, axis=1, keepdims=True)
        if not (sine >= CANONICAL_PALM_SINE_MIN).all():
            raise InputError(
                "canonical hand",
                wanted="palm bones that spread",
                came="two that are nearly parallel",
                remedy="Spread the fingers of the canonical hand.",
            )
        normal = normal / sine
        frames = np.empty((JOINT_COUNT, 3, 3))
        frames[0] = _palm_frame(bones)
        frames[1:6] = _metacarpal_frames(direction[:5], normal)
        u, swing = np.empty((15, 3)), np.empty((15, 3, 3))
        for first in (0, 5, 10):
            here, parent, child = (slice(first + start, first + start + 5) for start in (0, 1, 6))
            u[here] = unit(np.einsum("bji,bj->bi", frames[parent], direction[child.start - 1 : child.stop - 1]))
            swing[here] = euler_swing(u[here])
            frames[child] = frames[parent] @ swing[here]
        if (1 - np.abs(u[:, 1]) < CANONICAL_POLE_MIN).any():
            raise InputError("canonical hand", wanted="no finger bent sideways to 90 degrees", came="one is")
        return cls(joints[0], centered, length, direction, frames, u, swing, normal)


def _palm_frame(bones: np.ndarray) -> np.ndarray:
    """(3, 3): z along the sum of the metacarpals index..pinky, x along the area vector of their fan; neither is
    normalized before, so that each metacarpal counts by how well it is conditioned (METHOD 2.7)."""
    fan = bones[1:5]
    z = unit(fan.sum(axis=0))
    area = np.cross(fan[:-1], fan[1:]).sum(axis=0)
    x = unit(area - area @ z * z)
    return np.stack([x, np.cross(z, x), z], axis=-1)


def _metacarpal_frames(direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    """(5, 3, 3) of the metacarpals (5, 3) from the normals (4, 3) of the palm planes beside them."""
    beside = np.stack([normal[0], normal[1], (normal[1] + normal[2]) / 2, (normal[2] + normal[3]) / 2, normal[3]])
    y = unit(np.cross(direction, beside))
    return np.stack([np.cross(y, direction), y, direction], axis=-1)


def euler_swing(u: np.ndarray) -> np.ndarray:
    """(n, 3, 3) Q = R_y(flexion) R_x(abduction) with Q e_z = u (n, 3), away from the poles."""
    x, y, z = u.T
    across = np.hypot(x, z)
    cos_flexion, sin_flexion, zero = z / across, x / across, np.zeros_like(x)
    rows = [
        [cos_flexion, -sin_flexion * y, x],
        [zero, across, y],
        [-sin_flexion, -cos_flexion * y, z],
    ]
    return np.moveaxis(np.array(rows), -1, 0)
