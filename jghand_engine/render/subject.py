"""A hand in motion before a camera: what times and accuracies of images are measured on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.poses import MotionOptions, pose_sequence_of_names
from jghand_engine.render.camera import Camera

# joints move farther from frame to frame, meters: no pose is near enough to the last one to be reused
STEP_MIN_M = 1e-4
POSES = ("open", "relaxed", "fist", "pinch", "point", "victory", "open")


@dataclass(frozen=True)
class Subject:
    """A hand in motion before a camera. poses: (F, 21, 3) meters, level order"""

    name: str
    avatar: HandAvatar
    poses: np.ndarray
    camera: Camera


def moving_subject(name: str, hand: HandAvatar, width: int, height: int) -> Subject:
    """An avatar in motion, no two poses alike; the hand fills the height of the image."""
    canonical = hand.canonical_joints_m
    # the motion must not stand still: a hand at rest is not drawn again
    options = MotionOptions(hold_s=0.0, variation_deg=2.0)
    poses = pose_sequence_of_names(POSES, canonical, handedness=hand.handedness, options=options).joints_m
    step_m = np.abs(np.diff(poses, axis=0)).max(axis=(1, 2))
    poses = poses[1:][step_m > STEP_MIN_M]
    middle = poses.mean(axis=(0, 1))
    camera = Camera.looking_at(
        middle + np.array([0.15, 0.0, 0.6]),
        middle,
        (0.0, 1.0, 0.0),
        width=width,
        height=height,
        focal_px=3.0 * height,
    )
    return Subject(name, hand, poses, camera)
