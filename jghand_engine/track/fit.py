"""The motion of a skeleton that explains landmarks best: one robust least-squares fit of many frames at once.

Of every frame the fit knows where landmarks lie in the image and, from the detector's own estimate in space, where
bones point (costs.py). Between frames it wants small accelerations. Joint limits are part of it, and bones cannot
change length. Gauss-Newton with damping. Frames without a hand are filled by what is before and after them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError, solveh_banded

from jghand_engine.hand.rotations import alignment
from jghand_engine.track.costs import PoseCosts, Steadiness, Trust
from jghand_engine.track.poses import (
    ANGLE_COUNT,
    LIMITS_RAD,
    STATE_COUNT,
    JointChain,
    Landmarks,
    Pinhole,
    Poses,
    joined,
)

# Gauss-Newton steps; the steps end when the cost falls by less than this part, with no more damping than the first
FIT_STEPS = 30
FIT_TOLERANCE = 1e-5
# damping of its steps: the first, and between which it stays; beyond the largest no step helps any more
FIT_DAMPING = 1e-3
FIT_DAMPING_MIN = 1e-9
FIT_DAMPING_MAX = 1e6
# longest step of an angle, radians, and of the wrist, meters: as far as the linearization reaches
FIT_STEP_RAD = 0.6
FIT_STEP_M = 0.3
HAND_SPREAD_MIN_PX = 1e-3
# gaps of up to so many seconds are filled by the fit, which goes on from the speed before to that after; in longer ones
# it swings farther beyond both ends (5 degrees after 0.8 s) and is hardly nearer
FIT_GAP_S = 0.4
# what is seen on both sides of a gap of up to so many seconds is fitted together: bursts of a few frames are better
# for what is around them
FIT_REACH_S = 1.0
# frames that are fitted together at least, and how many seconds more on both sides so that the seam is not felt; at
# most so many frames there, for memory (0.1 MB per frame): with much smoothing in fast films seams may be felt
FIT_WINDOW_FRAMES = 900
FIT_MARGIN_S = 2.0
FIT_MARGIN_FRAMES_MAX = 1200


def fit(chain: JointChain, landmarks: Landmarks, trust: Trust | None = None) -> Poses:
    """The motion. Frames before the hand is first seen hold its first pose, those after the last one its last.

    At least one frame must show the hand. In gaps of up to `FIT_GAP_S` it goes as the fit says; in longer ones,
    and in all of them without smoothing, evenly from the pose before to the one after. What is seen on both sides of a
    gap of up to `FIT_REACH_S` is fitted together all the same. Long videos are fitted in parts that overlap, so
    that memory is bounded; what is as far away as the overlap has no influence.
    """
    trust = trust or Trust()
    seen = np.flatnonzero(landmarks.seen)
    start = initial_poses(chain, landmarks)
    believed = ~_in_long_gaps(landmarks.seen, FIT_GAP_S * landmarks.fps)
    fitted, known = [], []
    reach = None if trust.smoothing == 0 else FIT_REACH_S * landmarks.fps
    # so far reaches what a frame says, and farther with more smoothing
    margin = math.ceil(FIT_MARGIN_S * landmarks.fps * max(1.0, math.sqrt(trust.smoothing)))
    for kept, wide in _parts(seen, reach, min(margin, FIT_MARGIN_FRAMES_MAX)):
        poses = _fit_part(chain, landmarks.part(wide), start.part(wide), trust)
        kept = kept[believed[kept]]
        fitted.append(poses.part(np.isin(wide, kept)))
        known.append(kept)
    return joined(fitted).spread(np.concatenate(known), len(landmarks.image_px))


def _in_long_gaps(seen: np.ndarray, longest: float) -> np.ndarray:
    """(F,) bool, frames between two that were seen, with more than so many between them."""
    places = np.flatnonzero(seen)
    inside = np.zeros(len(seen), dtype=bool)
    for place in np.flatnonzero(np.diff(places) - 1 > longest):
        inside[places[place] + 1 : places[place + 1]] = True
    return inside


def _parts(seen: np.ndarray, longest_gap: float | None, margin: int) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Frames that are fitted together, in their order: those that are kept, and with what is around them.

    Both end at frames that were seen, so that no part has to guess where a gap ends. longest_gap: frames of a gap that
    is part of them; None for frames that know nothing of one another · margin: frames around what is kept.
    """
    # more than the longest gap has at any rate, and most of what is fitted is kept
    window = max(FIT_WINDOW_FRAMES, 2 * margin)
    if longest_gap is None:
        for begin in range(0, len(seen), window):
            yield seen[begin : begin + window], seen[begin : begin + window]
        return
    for run in np.split(seen, np.flatnonzero(np.diff(seen) - 1 > longest_gap) + 1):
        first, last = int(run[0]), int(run[-1])
        begin = first
        while begin <= last:
            # the last seen frame within the window is the first of the next part
            within = run[np.searchsorted(run, begin + window, side="right") - 1]
            end = int(within) if begin + window <= last else last + 1
            low = run[max(np.searchsorted(run, begin - margin, side="right") - 1, 0)]
            high = run[min(np.searchsorted(run, end + margin), len(run) - 1)]
            yield np.arange(begin, end), np.arange(low, high + 1)
            begin = end


def initial_poses(chain: JointChain, landmarks: Landmarks) -> Poses:
    """A first guess: the palm where it lies in space, fingers as bent as neighboring bones are to each other, the
    distance from the hand's size in the picture; between seen frames along the shortest way."""
    seen = np.flatnonzero(landmarks.seen)
    directions = landmarks.directions[seen]
    palm = chain.palm_m[1:] / np.linalg.norm(chain.palm_m[1:], axis=-1, keepdims=True)
    turn = alignment(np.broadcast_to(palm, (len(seen), 5, 3)), directions[:, :5])
    angle = np.zeros((len(seen), 5, 4))
    for joint, place in enumerate((0, 2, 3)):
        before, after = directions[:, 5 * joint : 5 * joint + 5], directions[:, 5 * joint + 5 : 5 * joint + 10]
        angle[:, :, place] = np.arccos(np.clip((before * after).sum(-1), -1, 1))
    angle[:, 0, 0] = 0.0  # a thumb's first joint is bent to the palm at rest
    angle = np.clip(angle.reshape(-1, ANGLE_COUNT), LIMITS_RAD[:, 0], LIMITS_RAD[:, 1])
    joints = chain.joints(angle) @ np.swapaxes(turn, -1, -2)
    place = _placed(joints, landmarks.image_px[seen], landmarks.camera)
    return Poses(turn, place, angle).spread(seen, len(landmarks.image_px))


def _placed(joints: np.ndarray, image_px: np.ndarray, camera: Pinhole) -> np.ndarray:
    """(F, 3) wrists: joints (F, 21, 3), turned, moved so that they have the middle and the size seen in the picture."""
    middle, image_middle = joints.mean(1), image_px.mean(1)
    wide = np.sqrt(np.square(joints[..., :2] - middle[:, None, :2]).sum(-1).mean(-1))
    image_wide = np.sqrt(np.square(image_px - image_middle[:, None]).sum(-1).mean(-1))
    depth = camera.focal_px * wide / np.maximum(image_wide, HAND_SPREAD_MIN_PX)
    return camera.rays(image_middle) * depth[:, None] - middle


# ---- the steps -------------------------------------------------------------------------------------------------------


def _fit_part(chain: JointChain, landmarks: Landmarks, poses: Poses, trust: Trust) -> Poses:
    """Frames that know of one another take each step together or not at all; frames alone each for itself."""
    steadiness = trust.steadiness(landmarks.fps)
    going = np.arange(len(poses))
    damping = np.full(len(poses) if steadiness is None else 1, FIT_DAMPING)
    for _ in range(FIT_STEPS):
        here = poses.part(going)
        costs = PoseCosts.of(chain, landmarks.part(going), trust, here)
        change = costs.derivatives(here)
        gradient = change.gradient if steadiness is None else change.gradient + steadiness.gradient(here.steps())
        there = here.moved(bounded(solve(damped(change.blocks, damping), gradient, steadiness)))
        before, after = _costs(costs, here, steadiness), _costs(costs, there, steadiness)
        better = after <= before
        moved = np.broadcast_to(better, len(going))
        poses = poses.replaced(going[moved], there.part(moved))
        # a short step may gain little because it was made short: then there may be more to gain
        settled = better & (before - after < FIT_TOLERANCE * before) & (damping <= FIT_DAMPING)
        damping = np.where(better, np.maximum(damping / 10, FIT_DAMPING_MIN), 10 * damping)
        left = ~(settled | (damping > FIT_DAMPING_MAX))
        if not left.any():
            break
        if steadiness is None:
            going, damping = going[left], damping[left]
    return replace(poses, angle_rad=np.clip(poses.angle_rad, LIMITS_RAD[:, 0], LIMITS_RAD[:, 1]))


def _costs(weighed: PoseCosts, poses: Poses, steadiness: Steadiness | None) -> np.ndarray:
    """(F,) of frames alone; (1,) of frames that know of one another."""
    costs = weighed.costs(poses)
    return costs if steadiness is None else costs.sum(keepdims=True) + steadiness.cost(poses.steps())


def damped(blocks: np.ndarray, damping: float | np.ndarray) -> np.ndarray:
    """(F, n, n) with a larger diagonal: shorter steps, and invertible also where nothing is known (Marquardt). damping:
    of all, or (F,)"""
    larger = blocks.copy()
    diagonal = np.einsum("fii->fi", blocks)
    np.einsum("fii->fi", larger)[...] += np.expand_dims(damping, -1) * diagonal + FIT_DAMPING_MIN
    return larger


def bounded(step: np.ndarray) -> np.ndarray:
    """No angle moves farther than its linearization reaches."""
    most = np.full(STATE_COUNT, FIT_STEP_RAD)
    most[3:6] = FIT_STEP_M
    return np.clip(step, -most, most)


def solve(blocks: np.ndarray, gradient: np.ndarray, steadiness: Steadiness | None) -> np.ndarray:
    """The step (F, n) that a Newton method takes: -(H + D)^-1 g, as one banded system.

    It is what a Kalman filter with a Rauch-Tung-Striebel smoother finds for the same model: it looks as far ahead as
    back, so it has no lag, and it closes gaps.

    blocks: (F, n, n) second derivatives of what is measured in each frame, positive definite · gradient: (F, n) of
    everything · steadiness: None for frames that know nothing of one another.
    """
    count, size = gradient.shape
    if steadiness is None or count == 1:
        return -np.linalg.solve(blocks, gradient[..., None])[..., 0]
    band = np.zeros((2 * size + 1, count, size))
    for row in range(size):
        for column in range(row + 1):
            band[row - column, :, column] = blocks[:, row, column]
    first, second = steadiness.first, steadiness.second
    band[0, 1:] += first
    band[0, :-1] += first
    band[size, :-1] -= first
    if count > 2:
        band[0, :-2] += second
        band[0, 1:-1] += 4 * second
        band[0, 2:] += second
        band[size, :-2] -= 2 * second
        band[size, 1:-1] -= 2 * second
        band[2 * size, :-2] += second
    flat = band.reshape(2 * size + 1, count * size)
    try:
        return -solveh_banded(flat, gradient.reshape(-1), lower=True, check_finite=False).reshape(count, size)
    except LinAlgError:
        # rounding made it indefinite: a longer diagonal is a shorter step, which is what the caller would try next
        flat[0] *= 1 + 1e-3
        return -solveh_banded(flat, gradient.reshape(-1), lower=True, check_finite=False).reshape(count, size)
