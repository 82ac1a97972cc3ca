"""The proportions of the hand that was seen, from where its landmarks lie in many pictures.

A fit with the bones of another hand bends fingers to make up for what differs: a finger that looks a tenth shorter than
it should is explained by bending it 26 degrees. So the motion is fitted with the hand's own proportions; its angles are
those of the avatar too, whose bones lie the same way when it is at rest. A detector's own idea of the bones is no help:
it wobbles, and its median is off by a fifth of the length.
"""

from __future__ import annotations

import numpy as np

from jghand_engine import limits
from jghand_engine.hand.joints import BONE_COUNT, JOINT_COUNT, PARENTS
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.tracking.fit import Landmarks, Poses, Trust, fit
from jghand_engine.tracking.skeleton import Skeleton


def own_canonical_joints(canonical_joints_m: np.ndarray, landmarks: Landmarks, length_m: float) -> np.ndarray:
    """A canonical hand (21, 3), level order, metres, with the proportions of the hand that was seen.

    canonical_joints_m: (21, 3) of a right hand: where the search starts, and what it is held to where pictures say
    little · length_m: wrist to middle tip along the bones.
    """
    directions = bone_directions(canonical_joints_m[None])
    start = bone_lengths(canonical_joints_m)
    shown = _spread(landmarks)
    # independent pictures are fewer than frames, and their errors have much in common
    share = min(1.0, limits.OWN_HAND_PICTURES / len(shown.image_px))
    change = np.zeros(BONE_COUNT)
    own = canonical_joints_m
    for _ in range(limits.OWN_HAND_ROUNDS):
        own = rebuilt(np.zeros((1, 3)), directions, start * np.exp(change))[0]
        own = own * (length_m / hand_length(own))
        skeleton = Skeleton.of(own)
        poses = fit(skeleton, shown, Trust(smoothing=0.0))
        matrix, wanted = _length_equations(skeleton, shown, poses)
        pull = limits.OWN_HAND_SIGMA**-2
        step = np.linalg.solve(share * matrix + pull * np.eye(BONE_COUNT), share * wanted - pull * change)
        change = change + step
        change -= change.mean()  # of the size itself one picture says nothing
    own = rebuilt(np.zeros((1, 3)), directions, start * np.exp(change))[0]
    return own * (length_m / hand_length(own))


def _spread(landmarks: Landmarks) -> Landmarks:
    """Seen frames, evenly spread, not too many."""
    seen = np.flatnonzero(landmarks.seen)
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, limits.OWN_HAND_FRAMES).round().astype(int))]
    return Landmarks(landmarks.image_px[chosen], landmarks.directions[chosen], landmarks.camera, landmarks.fps)


def _length_equations(skeleton: Skeleton, landmarks: Landmarks, poses: Poses) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations (20, 20), (20,) of what relative changes of the bones' lengths would mend in the pictures."""
    joints = poses.joints_m(skeleton)
    bones = joints[:, 1:] - joints[:, list(PARENTS[1:])]
    # a longer bone moves everything beyond it: (F, 21, 20, 3) metres per relative change
    moves = _beyond()[None, :, :, None] * bones[:, None]
    depth = joints[..., 2]
    flat = joints[..., :2] / depth[..., None]
    sigma_m = limits.LANDMARK_SIGMA * float(skeleton.bone_lengths_m[[2, 7, 12, 17]].sum())
    scale = (depth[:, :1] / sigma_m)[..., None]
    slope = (moves[..., :2] - flat[:, :, None] * moves[..., 2:]) / depth[:, :, None, None] * scale[..., None]
    residual = (landmarks.camera.rays(landmarks.image_px)[..., :2] - flat) * scale
    # where the hand is as a whole the poses have settled
    slope = slope - slope.mean(1, keepdims=True)
    residual = residual - residual.mean(1, keepdims=True)
    weight = 1 / (1 + np.square(residual).sum(-1) / limits.ROBUST_SIGMAS**2)
    matrix = np.einsum("fj,fjac,fjbc->ab", weight, slope, slope, optimize=True)
    return matrix, np.einsum("fj,fjac,fjc->a", weight, slope, residual, optimize=True)


def _beyond() -> np.ndarray:
    """(21, 20): whether joint j hangs on bone b (1..20, index b - 1)."""
    hangs = np.zeros((JOINT_COUNT, BONE_COUNT))
    for joint in range(1, JOINT_COUNT):
        on = joint
        while on > 0:
            hangs[joint, on - 1] = 1.0
            on = PARENTS[on]
    return hangs
