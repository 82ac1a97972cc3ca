"""How well poses explain landmarks, frame by frame, how steady they are, and how both change with them.

Landmarks in the picture, directions in space, joint limits and, where a hand was seen, a weak pull to rest. Wrong
landmarks lose their weight (Cauchy). Of a frame without a hand nothing but the joint limits is left.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT, PARENTS
from jghand_engine.hand.rotations import cross_matrices
from jghand_engine.track.poses import ANGLE_COUNT, LIMITS_RAD, STATE_COUNT, JointChain, Landmarks, Poses

# error of a landmark in the picture, part of the hand's length
LANDMARK_SIGMA = 0.015
# error of the direction of a bone in the detector's estimate in space, radians
DIRECTION_SIGMA = 0.3
# errors beyond this many standard deviations count less and less (Cauchy's loss)
ROBUST_SIGMAS = 3.0
# overstepping a joint's limit, radians
LIMIT_SIGMA_RAD = 0.02
# acceleration of joint angles and of the palm's turn, rad/s^2, and of the wrist, m/s^2, as white noise sampled at 30
# frames per second: a finger closes in 0.4 s with a peak of 57 rad/s^2
ANGLE_ACCELERATION = 25.0
TURN_ACCELERATION = 25.0
PLACE_ACCELERATION = 4.0
# speeds, rad/s and m/s: they hold a long gap back from swinging beyond its ends
ANGLE_SPEED = 8.0
TURN_SPEED = 8.0
PLACE_SPEED = 2.0
SMOOTHING_FPS = 30.0
# pull of an angle to its rest, radians: only for what no picture shows. Fingers are hardly spread otherwise than the
# canonical hand's: abduction is held so many times as firmly, else errors of landmarks and of bones end there
REST_SIGMA_RAD = 1.2
ABDUCTION_FIRMNESS = 8.0
# no joint is taken to be nearer to the camera, meters, and no hand to be smaller in the picture, pixels
FIT_DEPTH_MIN_M = 1e-2

_PARENTS = list(PARENTS[1:])


def _beyond() -> np.ndarray:
    """(21, 20): whether joint j hangs on bone b (1..20, index b - 1)."""
    hangs = np.zeros((JOINT_COUNT, BONE_COUNT))
    for joint in range(1, JOINT_COUNT):
        on = joint
        while on > 0:
            hangs[joint, on - 1] = 1.0
            on = PARENTS[on]
    return hangs


_BEYOND = _beyond()
# a hand at rest, for what a picture does not show: fingers half bent
REST_RAD = np.clip(np.tile(np.radians([25.0, 0.0, 35.0, 18.0]), 5), LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])
_FIRMNESS = np.tile([1.0, ABDUCTION_FIRMNESS, 1.0, 1.0], 5)


@dataclass(frozen=True)
class Steadiness:
    """How little the n numbers of a state may change: weights (1 / variance per frame) of the difference between
    neighboring frames and of the difference of those. first, second: (n,)"""

    first: np.ndarray
    second: np.ndarray

    def cost(self, steps: np.ndarray) -> float:
        """Half the weighted square of everything unsteady. steps: (F - 1, n) from each frame to the next."""
        return 0.5 * float((self.first * steps**2).sum() + (self.second * np.diff(steps, axis=0) ** 2).sum())

    def gradient(self, steps: np.ndarray) -> np.ndarray:
        """(F, n) derivative of the cost with respect to the states."""
        pull = self.first * steps
        change = self.second * np.diff(steps, axis=0)
        pull[1:] += change
        pull[:-1] -= change
        gradient = np.zeros((len(steps) + 1, steps.shape[1]))
        gradient[1:] += pull
        gradient[:-1] -= pull
        return gradient


@dataclass(frozen=True)
class Trust:
    """How much is believed, as standard deviations.

    landmark:  error of a landmark in the image, part of the hand's length
    direction: error of the direction of a bone in the detector's estimate in space, radians
    rest_rad:  pull of an angle to its rest; that of an abduction is firmer
    smoothing: more is smoother, 0 fits every frame alone
    """

    landmark: float = LANDMARK_SIGMA
    direction: float = DIRECTION_SIGMA
    rest_rad: float = REST_SIGMA_RAD
    smoothing: float = 1.0

    def steadiness(self, fps: float) -> Steadiness | None:
        """White noise of acceleration has a variance per frame that falls with the cube of the rate."""
        if self.smoothing == 0:
            return None
        sizes = [3, 3, ANGLE_COUNT]
        acceleration = np.repeat([TURN_ACCELERATION, PLACE_ACCELERATION, ANGLE_ACCELERATION], sizes)
        speed = np.repeat([TURN_SPEED, PLACE_SPEED, ANGLE_SPEED], sizes)
        # per frame at the rate for which the accelerations are given, then at this one
        second = acceleration / SMOOTHING_FPS**2 * (SMOOTHING_FPS / fps) ** 1.5 / self.smoothing
        first = speed / fps * (SMOOTHING_FPS / fps) ** -0.5
        return Steadiness(first**-2.0, second**-2.0)


@dataclass(frozen=True, eq=False)
class PoseCosts:
    """What poses are weighed by.

    depth_m: (F,) how far away the hand is taken to be where errors in the image are weighed as errors on the hand:
        those of the poses that a step begins with. It is no part of what is sought: a hand that came nearer would else
        make its errors smaller
    """

    chain: JointChain
    landmarks: Landmarks
    trust: Trust
    depth_m: np.ndarray

    @classmethod
    def of(cls, chain: JointChain, landmarks: Landmarks, trust: Trust, poses: Poses) -> PoseCosts:
        """For a step that begins with these poses."""
        return cls(chain, landmarks, trust, np.maximum(poses.place_m[:, 2], FIT_DEPTH_MIN_M))

    def costs(self, poses: Poses) -> np.ndarray:
        """(F,) half the weighted squares of what does not fit in each frame."""
        seen = self.landmarks.seen
        beyond, away = _off(poses, seen)
        costs = 0.5 * (LIMIT_SIGMA_RAD**-2 * beyond**2 + self._rest * away**2).sum(1)
        points = poses.part(seen).joints_m(self.chain)
        scale = ROBUST_SIGMAS**2
        for residual in (self._image_residual(points), self._direction_residual(points)):
            costs[seen] += 0.5 * scale * np.log1p(np.square(residual).sum(-1) / scale).sum(-1)
        return costs

    def derivatives(self, poses: Poses, *, with_lengths: bool = False) -> Derivatives:
        """How the costs change with the poses; with relative changes of the 20 bones' lengths too, if wanted."""
        seen = self.landmarks.seen
        size = STATE_COUNT + (BONE_COUNT if with_lengths else 0)
        gradient, blocks = np.zeros((len(poses), size)), np.zeros((len(poses), size, size))
        beyond, away = _off(poses, seen)
        limit = LIMIT_SIGMA_RAD**-2
        gradient[:, 6:STATE_COUNT] = limit * beyond + self._rest * away
        np.einsum("fii->fi", blocks)[:, 6:STATE_COUNT] = limit * (beyond != 0) + self._rest * seen[:, None]
        points, motion = _moving(self.chain, poses.part(seen), with_lengths)
        scale = ROBUST_SIGMAS**2
        for residual, slope in self._slopes(points, motion):
            weight = 1 / (1 + np.square(residual).sum(-1) / scale)
            weighted = slope * weight[..., None, None]
            flat, weighted = (array.reshape(len(points), -1, size) for array in (slope, weighted))
            gradient[seen] += np.einsum("fks,fk->fs", weighted, residual.reshape(len(points), -1))
            blocks[seen] += np.swapaxes(weighted, -1, -2) @ flat
        return Derivatives(gradient, blocks)

    def _slopes(self, points: np.ndarray, motion: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Residuals and how they change with the state: in the picture (f, 21, 2, n), of directions (f, 20, 3, n)."""
        depth = np.maximum(points[..., 2:], FIT_DEPTH_MIN_M)
        flat = points[..., :2] / depth
        slope = (motion[:, :, :2] - flat[..., None] * motion[:, :, 2:]) / depth[..., None]
        yield self._image_residual(points), slope * self._scale[:, None, None, None]
        bones = points[:, 1:] - points[:, _PARENTS]
        length = np.linalg.norm(bones, axis=-1, keepdims=True)
        unit = bones / length
        change = (motion[:, 1:] - motion[:, _PARENTS]) / length[..., None]
        across = change - unit[..., None] * (unit[..., None, :] @ change)
        yield self._direction_residual(points), across / self.trust.direction

    @property
    def _rest(self) -> np.ndarray:
        """(20,) how firmly angles are held to their rest: 1 / variance."""
        return (_FIRMNESS / self.trust.rest_rad) ** 2

    @property
    def _scale(self) -> np.ndarray:
        """(f,) of seen frames: standard deviations per unit of the ray, so that an error counts as it would on the
        hand itself."""
        sigma_m = self.trust.landmark * float(self.chain.bone_lengths_m[[2, 7, 12, 17]].sum())
        return self.depth_m[self.landmarks.seen] / sigma_m

    def _image_residual(self, points: np.ndarray) -> np.ndarray:
        """(f, 21, 2) in standard deviations."""
        rays = self.landmarks.camera.rays(self.landmarks.image_px[self.landmarks.seen])[..., :2]
        flat = points[..., :2] / np.maximum(points[..., 2:], FIT_DEPTH_MIN_M)
        return (flat - rays) * self._scale[:, None, None]

    def _direction_residual(self, points: np.ndarray) -> np.ndarray:
        """(f, 20, 3) in standard deviations."""
        bones = points[:, 1:] - points[:, _PARENTS]
        unit = bones / np.linalg.norm(bones, axis=-1, keepdims=True)
        return (unit - self.landmarks.directions[self.landmarks.seen]) / self.trust.direction


@dataclass(frozen=True, eq=False)
class Derivatives:
    """How costs change: gradient (F, n), second derivatives (F, n, n); n is 26, or 46 with the bones' lengths."""

    gradient: np.ndarray
    blocks: np.ndarray


def _off(poses: Poses, seen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F, 20) how far angles overstep their limits, and how far they are from rest in frames that say anything: what is
    not seen shall go the way between what is."""
    beyond = poses.angle_rad - np.clip(poses.angle_rad, LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])
    return beyond, (poses.angle_rad - REST_RAD) * seen[:, None]


def _moving(chain: JointChain, poses: Poses, with_lengths: bool) -> tuple[np.ndarray, np.ndarray]:
    """Joints (f, 21, 3), and how they move with the state (f, 21, 3, n)."""
    inside, bends = chain.joints_and_motion(poses.angle_rad)
    points = inside @ np.swapaxes(poses.turn, -1, -2) + poses.place_m[:, None]
    motion = np.zeros((len(poses), JOINT_COUNT, 3, STATE_COUNT + (BONE_COUNT if with_lengths else 0)))
    motion[..., :3] = -poses.turn[:, None] @ cross_matrices(inside)
    motion[..., 3:6] = np.eye(3)
    motion[..., 6:STATE_COUNT] = poses.turn[:, None] @ bends
    if with_lengths:
        # a longer bone moves everything beyond it
        bones = points[:, 1:] - points[:, _PARENTS]
        motion[..., STATE_COUNT:] = (_BEYOND[..., None] * bones[:, None]).swapaxes(-1, -2)
    return points, motion
