"""What a fit is about: landmarks of a hand over time, the camera that saw them, and the poses of a skeleton.

Camera axes: x right, y down, z forward; right hands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.track.skeleton import ANGLE_COUNT, Skeleton

# numbers of one frame: turn of the palm, place of the wrist, angles
STATE_COUNT = 6 + ANGLE_COUNT
# some of the frames: a slice, or their numbers
Frames = slice | np.ndarray


@dataclass(frozen=True)
class Pinhole:
    """focal_px, and the middle of the picture, pixels."""

    focal_px: float
    cx: float
    cy: float

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """(..., 3) camera axes -> (..., 2) pixels."""
        return self.focal_px * points_m[..., :2] / points_m[..., 2:] + (self.cx, self.cy)

    def rays(self, pixels: np.ndarray) -> np.ndarray:
        """(..., 2) pixels -> (..., 3) directions with z = 1."""
        flat = (pixels - (self.cx, self.cy)) / self.focal_px
        return np.concatenate([flat, np.ones_like(flat[..., :1])], -1)


@dataclass(frozen=True, eq=False)
class Landmarks:
    """One right hand over time, as it was seen.

    image_px: (F, 21, 2), NaN where it was not seen · directions: (F, 20, 3) unit, of bones 1..20, camera axes ·
    camera · fps
    """

    image_px: np.ndarray
    directions: np.ndarray
    camera: Pinhole
    fps: float

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool."""
        return np.asarray(np.isfinite(self.image_px).all(axis=(1, 2)))

    def part(self, frames: Frames) -> Landmarks:
        """Some of the frames."""
        return replace(self, image_px=self.image_px[frames], directions=self.directions[frames])


@dataclass(frozen=True, eq=False)
class Poses:
    """turn: (F, 3, 3) camera from canonical hand · place_m: (F, 3) wrist, camera axes · angle_rad: (F, 20)."""

    turn: np.ndarray
    place_m: np.ndarray
    angle_rad: np.ndarray

    def __len__(self) -> int:
        return len(self.angle_rad)

    def part(self, frames: Frames) -> Poses:
        """Some of the frames."""
        return Poses(self.turn[frames], self.place_m[frames], self.angle_rad[frames])

    def moved(self, step: np.ndarray) -> Poses:
        """After a step (F, 26)."""
        turn = self.turn @ vector_rotation(step[:, :3])
        return Poses(turn, self.place_m + step[:, 3:6], self.angle_rad + step[:, 6:])

    def steps(self) -> np.ndarray:
        """(F - 1, 26) how to come from each frame to the next."""
        between = np.swapaxes(self.turn[:-1], -1, -2) @ self.turn[1:]
        turns = Rotation.from_matrix(between).as_rotvec() if len(between) else np.zeros((0, 3))
        return np.concatenate([turns, np.diff(self.place_m, axis=0), np.diff(self.angle_rad, axis=0)], 1)

    def joints_m(self, skeleton: Skeleton) -> np.ndarray:
        """(F, 21, 3) camera axes."""
        return skeleton.joints(self.angle_rad) @ np.swapaxes(self.turn, -1, -2) + self.place_m[:, None]

    def replaced(self, frames: np.ndarray, there: Poses) -> Poses:
        """These, but for some of the frames."""
        turn, place_m, angle_rad = self.turn.copy(), self.place_m.copy(), self.angle_rad.copy()
        turn[frames], place_m[frames], angle_rad[frames] = there.turn, there.place_m, there.angle_rad
        return Poses(turn, place_m, angle_rad)

    def spread(self, known: np.ndarray, count: int) -> Poses:
        """These poses, of the frames `known` (F,), rising, as poses of `count` frames: between known ones on the
        shortest way, held before the first one and after the last."""
        frames = np.clip(np.arange(count), known[0], known[-1])
        if len(known) == 1:
            return self.part(np.zeros(count, dtype=int))
        turn = Slerp(known, Rotation.from_matrix(self.turn))(frames).as_matrix()
        flat = np.concatenate([self.place_m, self.angle_rad], 1)
        between = np.stack([np.interp(frames, known, column) for column in flat.T], -1)
        # known ones stay as they are, to the last bit
        place = np.searchsorted(known, frames)
        exact = known[place] == frames
        turn[exact], between[exact] = self.turn[place[exact]], flat[place[exact]]
        return Poses(turn, between[:, :3], between[:, 3:])


def joined(parts: list[Poses]) -> Poses:
    """Poses one after the other."""
    return Poses(
        np.concatenate([part.turn for part in parts]),
        np.concatenate([part.place_m for part in parts]),
        np.concatenate([part.angle_rad for part in parts]),
    )
