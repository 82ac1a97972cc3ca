"""Which joints of a pose are bent farther than an avatar has ever seen: there it can only guess what skin does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.avatar import AvatarInfo, HandAvatar
from jghand_engine.hand.joints import LEVEL_NAMES

# how far a joint may leave the range of angles that was trained, degrees, before it is told: the skin of a good avatar
# carries on so far (assumed)
POSE_RANGE_TOLERANCE_DEG = 8.0

ANGLE_NAMES = ("flexion", "abduction")


def angle_name(bone: int, kind: int) -> str:
    """What `AvatarInfo.pose_statistics` calls an angle of bone 6..20: `index1 flexion`. The joint is where the bone
    starts."""
    return f"{LEVEL_NAMES[bone - 5]} {ANGLE_NAMES[kind]}"


@dataclass(frozen=True)
class OutOfRange:
    """One angle that leaves the trained range by more than the tolerance. frame: where it is farthest outside ·
    angle_rad: there · low_rad, high_rad: the range · beyond_rad: how far outside of it"""

    name: str
    frame: int
    angle_rad: float
    low_rad: float
    high_rad: float
    beyond_rad: float

    def sentence(self) -> str:
        """`index1 flexion 105°: 12° outside the 0° to 93° that was trained`"""
        angle, low, high, beyond = (
            math.degrees(value) for value in (self.angle_rad, self.low_rad, self.high_rad, self.beyond_rad)
        )
        return f"{self.name} {angle:.0f}°: {beyond:.0f}° outside the {low:.0f}° to {high:.0f}° that was trained"


def trained_range(info: AvatarInfo) -> np.ndarray | None:
    """(2, 15, 2) least and greatest flexion and abduction of bones 6..20, radians; infinite where nothing is said.
    None for an avatar that was not trained."""
    if not info.pose_statistics:
        return None
    whole = (-math.inf, math.inf)
    ranges = [[info.pose_statistics.get(angle_name(bone, kind), whole) for kind in (0, 1)] for bone in range(6, 21)]
    return np.moveaxis(np.array(ranges), -1, 0)


def range_report(avatar: HandAvatar, joints_m: np.ndarray) -> list[OutOfRange]:
    """Every angle that is outside in some frame, once, the farthest first. joints_m: (F, 21, 3)."""
    limits_rad = trained_range(avatar.info)
    if limits_rad is None:
        return []
    skeleton = avatar.skeleton()
    return outside(np.stack([skeleton.bones(pose_m).phalanx_angles_rad for pose_m in joints_m]), limits_rad)


def outside(angles_rad: np.ndarray, limits_rad: np.ndarray) -> list[OutOfRange]:
    """The same from angles (..., 15, 2) and `trained_range`. An angle that is not finite is not outside."""
    angles = angles_rad.reshape(-1, 15, 2)
    low, high = limits_rad
    tolerance_rad = math.radians(POSE_RANGE_TOLERANCE_DEG)
    if not ((angles < low - tolerance_rad) | (angles > high + tolerance_rad)).any():
        return []
    beyond = np.nan_to_num(np.maximum(low - angles, angles - high), nan=-np.inf)
    worst = beyond.argmax(0)
    found = []
    for bone, kind in np.argwhere(beyond.max(0) > tolerance_rad):
        frame = int(worst[bone, kind])
        found.append(
            OutOfRange(
                name=angle_name(int(bone) + 6, int(kind)),
                frame=frame,
                angle_rad=float(angles[frame, bone, kind]),
                low_rad=float(low[bone, kind]),
                high_rad=float(high[bone, kind]),
                beyond_rad=float(beyond[frame, bone, kind]),
            )
        )
    return sorted(found, key=lambda one: -one.beyond_rad)
