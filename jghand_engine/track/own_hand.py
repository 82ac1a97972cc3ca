"""The proportions of the hand that was seen, from where its landmarks lie in many pictures.

A fit with the bones of another hand bends fingers to make up for what differs: a finger that looks a tenth shorter than
it should is explained by bending it 26 degrees. So the motion is fitted with the hand's own proportions; its angles are
those of the avatar too, whose bones lie the same way when it is at rest. A detector's own idea of the bones is no help:
it wobbles, and its median is off by a fifth of the length.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jghand_engine.hand.joints import BONE_COUNT
from jghand_engine.hand.orders import bone_lengths, hand_length
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.track.costs import Derivatives, PoseCosts, Trust
from jghand_engine.track.fit import FIT_DAMPING, bounded, damped, fit
from jghand_engine.track.poses import STATE_COUNT, JointChain, Landmarks

# proportions of the hand that is seen: how far a bone's length differs from the start's, relative; frames that are
# looked at, as many of them as count as independent, and rounds of fitting poses and lengths in turn
OWN_HAND_SIGMA = 0.03
OWN_HAND_FRAMES = 200
OWN_HAND_PICTURES = 30
OWN_HAND_ROUNDS = 12


def own_canonical_joints(canonical_joints_m: np.ndarray, landmarks: Landmarks, length_m: float) -> np.ndarray:
    """A canonical hand (21, 3), level order, meters, with the proportions of the hand that was seen.

    canonical_joints_m: (21, 3) of a right hand: where the search starts, and what it is held to where pictures say
    little · length_m: wrist to middle tip along the bones.
    """
    directions = bone_directions(canonical_joints_m[None])

    def hand(change: np.ndarray) -> tuple[np.ndarray, float]:
        """Joints of that length, and how much larger they became for it."""
        joints = rebuilt(np.zeros((1, 3)), directions, bone_lengths(canonical_joints_m) * np.exp(change))[0]
        larger = length_m / hand_length(joints)
        return joints * larger, larger

    shown = _spread(landmarks)
    # independent pictures are fewer than frames, and their errors have much in common
    share = min(1.0, OWN_HAND_PICTURES / len(shown.image_px))
    pull, trust = OWN_HAND_SIGMA**-2 / share, Trust(smoothing=0.0)
    change, damping = np.zeros(BONE_COUNT), FIT_DAMPING
    joints, size = hand(change)
    poses = fit(JointChain.of(joints), shown, trust)
    for _ in range(OWN_HAND_ROUNDS):
        costs = PoseCosts.of(JointChain.of(joints), shown, trust, poses)
        step, longer = _step(costs.derivatives(poses, with_lengths=True), pull, change, damping)
        longer = change + longer
        joints_there, size_there = hand(longer)
        # a hand that is made larger to have its length stands so much farther away
        moved = poses.moved(bounded(step))
        moved = replace(moved, place_m=moved.place_m * (size_there / size))
        before = costs.costs(poses).sum() + 0.5 * pull * change @ change
        after = replace(costs, chain=JointChain.of(joints_there)).costs(moved).sum() + 0.5 * pull * longer @ longer
        if after > before:
            damping *= 10
            continue
        poses, change, joints, size, damping = moved, longer, joints_there, size_there, damping / 10
    return joints


def _step(now: Derivatives, pull: float, change: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
    """Newton's step of all poses (F, 26) and of the lengths (20,) that they share: the poses are eliminated first."""
    blocks = damped(now.blocks, damping)
    of_poses, across = blocks[:, :STATE_COUNT, :STATE_COUNT], blocks[:, :STATE_COUNT, STATE_COUNT:]
    pose_gradient = now.gradient[:, :STATE_COUNT, None]
    solved = np.linalg.solve(of_poses, np.concatenate([across, pose_gradient], -1))
    turned = np.swapaxes(across, -1, -2) @ solved
    matrix = (blocks[:, STATE_COUNT:, STATE_COUNT:] - turned[..., :-1]).sum(0) + pull * np.eye(BONE_COUNT)
    gradient = now.gradient[:, STATE_COUNT:].sum(0) - turned[..., -1].sum(0) + pull * change
    longer = -np.linalg.solve(matrix, gradient)
    return -(solved[..., -1] + solved[..., :-1] @ longer), longer


def _spread(landmarks: Landmarks) -> Landmarks:
    """Seen frames, evenly spread, not too many."""
    seen = np.flatnonzero(landmarks.seen)
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, OWN_HAND_FRAMES).round().astype(int))]
    return landmarks.part(chosen)
