"""Synthetic hands of known size for measuring: twenty filled capsules, 18 cm, 60,000 Gaussians.

They are the volumes A (heavy: sigma 1.5 to 2.5 mm) and B (light: 0.5 to 0.83 mm) of RENDERING, for which all its
figures hold. Every Gaussian belongs to one bone, so they can be posed like any avatar.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.errors import InputError
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT, PARENTS, Handedness
from jghand_engine.hand.orders import JointOrder, to_level
from jghand_engine.render.camera import Camera

# sigma, millimeters, and pixels per millimeter at 512 x 334: the hand covers 40 to 44 % of the picture
VOLUMES = {"A": ((1.5, 2.5), 2.02), "B": ((0.5, 0.8333), 2.2)}
GAUSSIANS = 60_000
DISTANCE_M = 0.6

# millimeters: first joints, direction and length of the phalanges, thumb to pinky; capsule radii by level
_FIRST = np.array([[40, -38, 0], [88, -26, 2], [90, -4, 3], [85, 17, 2], [78, 36, 0]], float)
_DIRECTION = np.array([[0.72, -0.69, 0], [0.98, -0.18, 0], [1, 0, 0], [0.98, 0.18, 0], [0.92, 0.38, 0]])
_LENGTH = np.array([[34, 28, 24], [38, 24, 20], [44, 27, 20], [40, 26, 20], [31, 19, 18]], float)
_RADIUS = (15.0, 10.0, 8.5, 7.5)
_BEND = 0.12
_TILT_RAD = 0.25


@dataclass(frozen=True)
class SyntheticHand:
    """avatar: its canonical joints are also its pose · name: A or B"""

    name: str
    avatar: HandAvatar

    def camera(self, width: int = 512, height: int = 334) -> Camera:
        """Looks at the canonical pose from DISTANCE_M; the hand covers as much of any size as of 512 x 334."""
        focal_px = VOLUMES[self.name][1] * 1e3 * DISTANCE_M * math.sqrt(width * height / (512 * 334))
        matrix = np.eye(4)
        matrix[2, 3] = DISTANCE_M
        return Camera(width, height, focal_px, focal_px, width / 2, height / 2, matrix)

    def poses(self, count: int, seed: int = 0) -> np.ndarray:
        """(count, 21, 3) meters: the canonical joints, moved smoothly by some millimeters, no two alike."""
        random = np.random.default_rng(seed)
        phase, speed = random.uniform(0, 2 * np.pi, (2, JOINT_COUNT, 3))
        moved_m = 0.003 * np.sin(phase + 0.3 * (1 + speed) * np.arange(count)[:, None, None])
        return self.avatar.canonical_joints_m + moved_m


def synthetic_hand(name: str, count: int = GAUSSIANS, seed: int = 0) -> SyntheticHand:
    """Volume A or B. InputError for another name."""
    if name not in VOLUMES:
        raise InputError("synthetic hand", wanted=" | ".join(VOLUMES), came=name)
    random = np.random.default_rng(seed)
    joints_mm = to_level(_joints_mm(), JointOrder.STANDARD)
    per_bone = count // BONE_COUNT
    bones = range(1, JOINT_COUNT)
    position = np.concatenate([_in_capsule(joints_mm, bone, per_bone, random) for bone in bones])
    turn = _tilt()
    n = len(position)
    order = random.permutation(n)
    weights = np.zeros((n, JOINT_COUNT), np.float32)
    weights[np.arange(n), np.repeat(bones, per_bone)] = 1
    color = np.array([0.8, 0.6, 0.5]) + 0.15 * np.sin(0.12 * position[:, :1] + np.arange(3))
    color = np.clip(color + random.normal(0, 0.08, (n, 3)), 0.02, 1)

    def ordered(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values[order], np.float32)

    avatar = HandAvatar(
        info=AvatarInfo(name=f"volume {name}", template="capsules", license="MIT"),
        handedness=Handedness.RIGHT,
        canonical_joints_m=1e-3 * joints_mm @ turn.T,
        position_m=ordered(1e-3 * position @ turn.T),
        sigma_m=ordered(1e-3 * random.uniform(*VOLUMES[name][0], n)),
        opacity=ordered(random.uniform(0.3, 0.95, n)),
        rgb=ordered(color),
        bone_weights=ordered(weights),
        uvd=ordered(np.zeros((n, 3))),
    )
    return SyntheticHand(name, avatar)


def _joints_mm() -> np.ndarray:
    """(21, 3) standard order, in the middle of its box; x from wrist to fingers."""
    joints = [np.zeros(3)]
    for first, direction, lengths in zip(_FIRST, _DIRECTION, _LENGTH, strict=True):
        joints.append(first)
        for level, length in enumerate(lengths):
            along = direction + np.array([0, 0, _BEND * level])
            joints.append(joints[-1] + length * along / np.linalg.norm(along))
    stacked = np.array(joints)
    return stacked - 0.5 * (stacked.min(axis=0) + stacked.max(axis=0))


def _in_capsule(joints_mm: np.ndarray, bone: int, count: int, random: np.random.Generator) -> np.ndarray:
    """(count, 3) points, even in the capsule around a bone."""
    start, end = joints_mm[PARENTS[bone]], joints_mm[bone]
    radius, length = _RADIUS[(bone - 1) // 5], float(np.linalg.norm(end - start))
    along = (end - start) / length
    across = np.cross(along, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    axes = np.stack([along, across, np.cross(along, across)])
    found = np.empty((0, 3))
    while len(found) < count:
        drawn = random.uniform([-radius] * 3, [length + radius, radius, radius], (4 * count, 3))
        beyond = drawn[:, 0] - np.clip(drawn[:, 0], 0, length)
        inside = beyond**2 + drawn[:, 1] ** 2 + drawn[:, 2] ** 2 <= radius**2
        found = np.concatenate([found, drawn[inside]])
    return start + found[:count] @ axes


def _tilt() -> np.ndarray:
    cosine, sine = math.cos(_TILT_RAD), math.sin(_TILT_RAD)
    return np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]])
