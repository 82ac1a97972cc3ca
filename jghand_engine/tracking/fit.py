"""The motion of a skeleton that explains landmarks best: one robust least-squares fit of many frames at once.

Of every frame the fit knows where landmarks lie in the picture and, from the detector's own estimate in space, where
bones point. Between frames it wants small accelerations. Joint limits are part of it, and bones cannot change length.
Gauss-Newton with damping; wrong landmarks lose their weight (Cauchy). Frames without a hand are filled by what
is before and after them. Camera axes: x right, y down, z forward; right hands.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from jghand_engine import limits
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT, PARENTS
from jghand_engine.hand.sequence import alignment
from jghand_engine.tracking.skeleton import (
    ANGLE_COUNT,
    LIMITS_RAD,
    Skeleton,
    cross_matrices,
    rotations_of,
)
from jghand_engine.tracking.smoother import Steadiness, solve

# numbers of one frame: turn of the palm, place of the wrist, angles
STATE_COUNT = 6 + ANGLE_COUNT
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
# a hand at rest, for frames of which nothing is known: fingers half bent
_REST_RAD = np.clip(np.tile(np.radians([25.0, 0.0, 35.0, 18.0]), 5), LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])


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


@dataclass(frozen=True)
class Landmarks:
    """One right hand over time, as it was seen.

    image_px: (F, 21, 2), NaN where it was not seen · directions: (F, 20, 3) unit, of bones 1..20, camera axes; None
    where nothing but the picture is to be believed · camera · fps
    """

    image_px: np.ndarray
    directions: np.ndarray
    camera: Pinhole
    fps: float

    @property
    def seen(self) -> np.ndarray:
        """(F,) bool."""
        return np.asarray(np.isfinite(self.image_px).all(axis=(1, 2)))

    def part(self, frames: slice) -> Landmarks:
        """Some of the frames."""
        return replace(self, image_px=self.image_px[frames], directions=self.directions[frames])


@dataclass(frozen=True)
class Poses:
    """turn: (F, 3, 3) camera from canonical hand · place_m: (F, 3) wrist, camera axes · angle_rad: (F, 20)."""

    turn: np.ndarray
    place_m: np.ndarray
    angle_rad: np.ndarray

    def __len__(self) -> int:
        return len(self.angle_rad)

    def part(self, frames: slice) -> Poses:
        return Poses(self.turn[frames], self.place_m[frames], self.angle_rad[frames])

    def moved(self, step: np.ndarray) -> Poses:
        """After a step (F, 26)."""
        turn = self.turn @ rotations_of(step[:, :3])
        return Poses(turn, self.place_m + step[:, 3:6], self.angle_rad + step[:, 6:])

    def steps(self) -> np.ndarray:
        """(F - 1, 26) how to come from each frame to the next."""
        between = np.swapaxes(self.turn[:-1], -1, -2) @ self.turn[1:]
        turns = Rotation.from_matrix(between).as_rotvec() if len(between) else np.zeros((0, 3))
        return np.concatenate([turns, np.diff(self.place_m, axis=0), np.diff(self.angle_rad, axis=0)], 1)

    def joints_m(self, skeleton: Skeleton) -> np.ndarray:
        """(F, 21, 3) camera axes."""
        return skeleton.joints(self.angle_rad) @ np.swapaxes(self.turn, -1, -2) + self.place_m[:, None]


@dataclass(frozen=True)
class Trust:
    """How much is believed: standard deviations (`jghand_engine.limits`, tracking). smoothing: 1, less for a smoother
    motion; 0 fits every frame alone."""

    landmark: float = limits.LANDMARK_SIGMA
    direction: float = limits.DIRECTION_SIGMA
    rest_rad: float = limits.REST_SIGMA_RAD
    smoothing: float = 1.0

    def steadiness(self, fps: float) -> Steadiness | None:
        """White noise of acceleration has a variance per frame that falls with the cube of the rate."""
        if self.smoothing == 0:
            return None
        sizes = [3, 3, ANGLE_COUNT]
        acceleration = np.repeat(
            [limits.TURN_ACCELERATION, limits.PLACE_ACCELERATION, limits.ANGLE_ACCELERATION], sizes
        )
        speed = np.repeat([limits.TURN_SPEED, limits.PLACE_SPEED, limits.ANGLE_SPEED], sizes)
        # per frame at the rate for which the accelerations are given, then at this one
        second = acceleration / limits.SMOOTHING_FPS**2 * (limits.SMOOTHING_FPS / fps) ** 1.5 / self.smoothing
        first = speed / fps * (limits.SMOOTHING_FPS / fps) ** -0.5
        return Steadiness(first**-2.0, second**-2.0)


def fit(skeleton: Skeleton, landmarks: Landmarks, trust: Trust | None = None) -> Poses:
    """The motion. Frames before the hand is first seen hold its first pose, those after the last one its last.

    At least one frame must show the hand. Long videos are fitted in parts that overlap, so that memory is bounded; what
    is as far away as the overlap has no influence.
    """
    trust = trust or Trust()
    frames = np.flatnonzero(landmarks.seen)
    first, last = int(frames[0]), int(frames[-1]) + 1
    inner = landmarks.part(slice(first, last))
    start = initial_poses(skeleton, inner)
    parts = []
    window, margin = limits.FIT_WINDOW_FRAMES, limits.FIT_MARGIN_FRAMES
    for begin in range(0, last - first, window):
        end = min(begin + window, last - first)
        wide = slice(max(0, begin - margin), min(last - first, end + margin))
        fitted = _fit_together(skeleton, inner.part(wide), start.part(wide), trust)
        parts.append(fitted.part(slice(begin - wide.start, end - wide.start)))
    hold = np.clip(np.arange(len(landmarks.image_px)) - first, 0, last - first - 1)
    return Poses(
        np.concatenate([part.turn for part in parts])[hold],
        np.concatenate([part.place_m for part in parts])[hold],
        np.concatenate([part.angle_rad for part in parts])[hold],
    )


def initial_poses(skeleton: Skeleton, landmarks: Landmarks) -> Poses:
    """A first guess: the palm where it lies in space, fingers as bent as neighbouring bones are to each other, the
    distance from the hand's size in the picture; between seen frames along the shortest way."""
    seen = np.flatnonzero(landmarks.seen)
    directions = landmarks.directions[seen]
    palm = skeleton.palm_m[1:] / np.linalg.norm(skeleton.palm_m[1:], axis=-1, keepdims=True)
    turn = alignment(np.broadcast_to(palm, (len(seen), 5, 3)), directions[:, :5])
    angle = np.zeros((len(seen), 5, 4))
    for joint, place in enumerate((0, 2, 3)):
        before, after = directions[:, 5 * joint : 5 * joint + 5], directions[:, 5 * joint + 5 : 5 * joint + 10]
        angle[:, :, place] = np.arccos(np.clip((before * after).sum(-1), -1, 1))
    angle[:, 0, 0] = 0.0  # a thumb's first joint is bent to the palm at rest
    angle = np.clip(angle.reshape(-1, ANGLE_COUNT), LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])
    joints = skeleton.joints(angle) @ np.swapaxes(turn, -1, -2)
    place = _placed(joints, landmarks.image_px[seen], landmarks.camera)
    count = np.arange(len(landmarks.image_px))
    if len(seen) == 1:
        turns = np.repeat(turn, len(count), axis=0)
    else:
        turns = Slerp(seen, Rotation.from_matrix(turn))(np.clip(count, seen[0], seen[-1])).as_matrix()
    between = [np.interp(count, seen, column) for column in np.concatenate([place, angle], 1).T]
    return Poses(turns, np.stack(between[:3], -1), np.stack(between[3:], -1))


def _placed(joints: np.ndarray, image_px: np.ndarray, camera: Pinhole) -> np.ndarray:
    """(F, 3) wrists: joints (F, 21, 3), turned, moved so that they have the middle and the size seen in the picture."""
    middle, image_middle = joints.mean(1), image_px.mean(1)
    wide = np.sqrt(np.square(joints[..., :2] - middle[:, None, :2]).sum(-1).mean(-1))
    image_wide = np.sqrt(np.square(image_px - image_middle[:, None]).sum(-1).mean(-1))
    depth = camera.focal_px * wide / np.maximum(image_wide, limits.HAND_SPREAD_MIN_PX)
    return camera.rays(image_middle) * depth[:, None] - middle


# ---- the fit of frames that know of one another ----------------------------------------------------------------------


def _fit_together(skeleton: Skeleton, landmarks: Landmarks, poses: Poses, trust: Trust) -> Poses:
    steadiness = trust.steadiness(landmarks.fps)
    damping = limits.FIT_DAMPING
    now = look_at(skeleton, landmarks, poses, trust)
    cost = now.cost + _unsteadiness(poses, steadiness)
    for _ in range(limits.FIT_STEPS):
        gradient = now.gradient if steadiness is None else now.gradient + steadiness.gradient(poses.steps())
        moved = poses.moved(bounded(solve(damped(now.blocks, damping), gradient, steadiness)))
        there = look_at(skeleton, landmarks, moved, trust)
        moved_cost = there.cost + _unsteadiness(moved, steadiness)
        if moved_cost > cost:
            damping *= 10
            if damping > limits.FIT_DAMPING_MAX:
                break
            continue
        done = cost - moved_cost < limits.FIT_TOLERANCE * cost
        poses, now, cost, damping = moved, there, moved_cost, max(damping / 10, limits.FIT_DAMPING_MIN)
        if done:
            break
    return replace(poses, angle_rad=np.clip(poses.angle_rad, LIMITS_RAD[:, 0], LIMITS_RAD[:, 1]))


def damped(blocks: np.ndarray, damping: float) -> np.ndarray:
    """(F, n, n) with a larger diagonal: shorter steps, and invertible also where nothing is known (Marquardt)."""
    larger = blocks.copy()
    np.einsum("fii->fi", larger)[...] += damping * np.einsum("fii->fi", blocks) + limits.FIT_DAMPING_MIN
    return larger


def bounded(step: np.ndarray) -> np.ndarray:
    """No angle moves farther than its linearisation reaches."""
    most = np.full(STATE_COUNT, limits.FIT_STEP_RAD)
    most[3:6] = limits.FIT_STEP_M
    return np.clip(step, -most, most)


def _unsteadiness(poses: Poses, steadiness: Steadiness | None) -> float:
    return 0.0 if steadiness is None else steadiness.cost(poses.steps())


@dataclass(frozen=True)
class Look:
    """What the frames say of themselves: cost of all, gradient (F, n), second derivatives (F, n, n); n is 26, or 46
    with the lengths of the bones."""

    cost: float
    gradient: np.ndarray
    blocks: np.ndarray


def look_at(
    skeleton: Skeleton, landmarks: Landmarks, poses: Poses, trust: Trust, *, with_lengths: bool = False
) -> Look:
    """How well poses explain landmarks, and how that changes with them; with relative changes of the 20 bones' lengths
    too, if they are wanted. Nothing of what frames know of one another is in it."""
    count, size = len(poses), STATE_COUNT + (BONE_COUNT if with_lengths else 0)
    gradient = np.zeros((count, size))
    blocks = np.zeros((count, size, size))
    cost = _priors(poses, trust, gradient, blocks)
    seen = np.flatnonzero(landmarks.seen)
    inside, bends = skeleton.joints_and_motion(poses.angle_rad[seen])
    turn = poses.turn[seen]
    points = inside @ np.swapaxes(turn, -1, -2) + poses.place_m[seen][:, None]
    # how the joints move with the state: (f, 21, 3, n)
    motion = np.zeros((len(seen), 21, 3, size))
    motion[..., :3] = -turn[:, None] @ cross_matrices(inside)
    motion[..., 3:6] = np.eye(3)
    motion[..., 6:STATE_COUNT] = turn[:, None] @ bends
    if with_lengths:
        # a longer bone moves everything beyond it
        bones = points[:, 1:] - points[:, _PARENTS]
        motion[..., STATE_COUNT:] = (_BEYOND[..., None] * bones[:, None]).swapaxes(-1, -2)
    for residual, slope in (
        _image_residual(skeleton, landmarks, points, motion, seen, trust),
        _direction_residual(landmarks, points, motion, seen, trust),
    ):
        square = np.square(residual).sum(-1)
        scale = limits.ROBUST_SIGMAS**2
        cost += 0.5 * scale * float(np.log1p(square / scale).sum())
        weight = 1 / (1 + square / scale)
        weighted = slope * weight[..., None, None]
        flat, weighted = (array.reshape(len(seen), -1, size) for array in (slope, weighted))
        gradient[seen] += np.einsum("fks,fk->fs", weighted, residual.reshape(len(seen), -1))
        blocks[seen] += np.swapaxes(weighted, -1, -2) @ flat
    return Look(cost, gradient, blocks)


def _priors(poses: Poses, trust: Trust, gradient: np.ndarray, blocks: np.ndarray) -> float:
    """Joint limits and the weak pull to rest; adds to gradient and blocks, returns the cost."""
    beyond = poses.angle_rad - np.clip(poses.angle_rad, LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])
    away = poses.angle_rad - _REST_RAD
    limit, rest = limits.LIMIT_SIGMA_RAD**-2, trust.rest_rad**-2
    gradient[:, 6:STATE_COUNT] += limit * beyond + rest * away
    np.einsum("fii->fi", blocks)[:, 6:STATE_COUNT] += limit * (beyond != 0) + rest
    return 0.5 * float((limit * beyond**2 + rest * away**2).sum())


def _image_residual(
    skeleton: Skeleton, landmarks: Landmarks, points: np.ndarray, motion: np.ndarray, seen: np.ndarray, trust: Trust
) -> tuple[np.ndarray, np.ndarray]:
    """(f, 21, 2) in standard deviations, and its slope (f, 21, 2, n). Lengths in the picture are brought to the hand's
    depth, so that an error counts as it would on the hand itself."""
    lengths = skeleton.bone_lengths_m
    sigma_m = trust.landmark * float(lengths[[2, 7, 12, 17]].sum())
    depth = np.maximum(points[..., 2:], limits.FIT_DEPTH_MIN_M)
    rays = landmarks.camera.rays(landmarks.image_px[seen])[..., :2]
    flat = points[..., :2] / depth
    # per unit of the ray: the wrist's depth over sigma, taken as a constant of this step
    scale = depth[:, :1] / sigma_m
    slope = (motion[:, :, :2] - flat[..., None] * motion[:, :, 2:]) / depth[..., None] * scale[..., None]
    return (flat - rays) * scale, slope


def _direction_residual(
    landmarks: Landmarks, points: np.ndarray, motion: np.ndarray, seen: np.ndarray, trust: Trust
) -> tuple[np.ndarray, np.ndarray]:
    """(f, 20, 3) in standard deviations, and its slope (f, 20, 3, n)."""
    bones = points[:, 1:] - points[:, _PARENTS]
    length = np.linalg.norm(bones, axis=-1, keepdims=True)
    unit = bones / length
    change = (motion[:, 1:] - motion[:, _PARENTS]) / length[..., None]
    across = change - unit[..., None] * (unit[..., None, :] @ change)
    return (unit - landmarks.directions[seen]) / trust.direction, across / trust.direction
