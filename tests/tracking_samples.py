"""A hand in known motion before a known camera, as a perfect detector would see it."""

from dataclasses import dataclass

import numpy as np

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.track.detection import SeenHand
from jghand_engine.track.poses import LIMITS_RAD, JointChain, Pinhole, Poses
from jghand_engine.track.track import Sightings

CANONICAL_M = load_builtin(handedness=Handedness.RIGHT).canonical_joints_m
WIDTH, HEIGHT, FPS = 640, 480, 30.0
# what is assumed of an unknown camera, 66 degrees across 640 pixels
CAMERA = Pinhole(320 / np.tan(np.radians(33)), 320.0, 240.0)


def moving_poses(count: int = 60, fps: float = FPS) -> Poses:
    """A palm before the camera, fingers up, that sways while the fingers bend, inside the limits."""
    time = np.arange(count) / fps
    phase = np.arange(20)
    bent = np.radians(30 + 22 * np.sin(2.5 * time[:, None] + phase))
    bent[:, 1::4] = np.radians(4 * np.sin(time[:, None] + phase[1::4]))
    bent[:, :4] *= 0.3  # the thumb reaches less far
    angle = np.clip(bent, LIMITS_RAD[:, 0] + 0.02, LIMITS_RAD[:, 1] - 0.02)
    # the canonical hand has y up and z out of the palm: half a turn about x brings it before a camera
    turn = vector_rotation(np.array([[np.pi, 0.0, 0.0]])) @ vector_rotation(
        np.stack([0.2 * np.sin(time), 0.3 * np.sin(0.8 * time), 0.2 * np.sin(1.3 * time)], -1)
    )
    place = np.stack([0.05 * np.sin(time), 0.09 + 0.02 * np.cos(time), 0.5 + 0.04 * np.sin(0.7 * time)], -1)
    return Poses(turn, place, angle)


@dataclass
class Sight:
    """joints_m: (F, 21, 3) camera axes, meters · sightings: what a perfect detector says of them."""

    joints_m: np.ndarray
    sightings: Sightings


def sight(joints_m: np.ndarray, handedness: Handedness = Handedness.RIGHT, label: Handedness | None = None) -> Sight:
    """joints_m: (F, 21, 3) camera axes. label: what the detector calls the hand."""
    frames = [[seen(joints, label or handedness)] for joints in joints_m]
    return Sight(joints_m, Sightings(FPS, (HEIGHT, WIDTH), frames))


def seen(joints_m: np.ndarray, handedness: Handedness, score: float = 0.95) -> SeenHand:
    """What a detector says that is right: landmarks where they are, and the hand about its middle."""
    return SeenHand(CAMERA.project(joints_m), joints_m - joints_m.mean(0), handedness, score)


def right_joints_m(count: int = 60) -> np.ndarray:
    """(F, 21, 3) of `moving_poses` on the built-in hand, camera axes."""
    return moving_poses(count).joints_m(JointChain.of(CANONICAL_M))
