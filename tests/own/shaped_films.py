"""Small films of a hand whose truth is known, drawn by the engine: other bones and thickness than the prior's."""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.hand.joints import Handedness
from jghand_engine.hand.orders import bone_lengths
from jghand_engine.hand.rotations import vector_rotation
from jghand_engine.hand.sequence import bone_directions, rebuilt
from jghand_engine.own.shape import SHAPE_COUNT, in_shape
from jghand_engine.own.start import Start
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings
from jghand_engine.track.poses import LIMITS_RAD, JointChain, Poses

# no texture of the skin, which takes seconds to make ready
PRIOR = replace(load_builtin(handedness=Handedness.RIGHT).prefix(2000), detail=None)
CANONICAL_M = PRIOR.canonical_joints_m
WIDTH, HEIGHT, FOCAL_PX, FPS = 96, 160, 118.0, 7.5


@dataclass(frozen=True)
class Film:
    """poses, joints_m (F, 21, 3), canonical_joints_m (21, 3), shape (56,): the truth · rgb_u8, masks: (F, H, W, ...)"""

    camera: Camera
    poses: Poses
    joints_m: np.ndarray
    canonical_joints_m: np.ndarray
    shape: np.ndarray
    rgb_u8: np.ndarray
    masks: np.ndarray
    time_s: np.ndarray

    def start(self, poses: Poses | None = None, noise_px: float = 0.0, canonical_joints_m=None) -> Start:
        """As a detector sees it, that is off by so much, and a tracker that has these poses; else the true ones."""
        random = np.random.default_rng(4)
        pixels = self.camera.project(self.joints_m)[0]
        landmarks = pixels + noise_px * random.standard_normal(pixels.shape)
        canonical = self.canonical_joints_m if canonical_joints_m is None else canonical_joints_m
        return Start(
            self.camera, Handedness.RIGHT, landmarks, bone_directions(self.joints_m), poses or self.poses, canonical
        )


def poses_of(count: int) -> Poses:
    """A palm before the camera that turns over while its fingers bend."""
    time = np.linspace(0, 1, count)
    bent = np.radians(28 + 22 * np.sin(5 * time[:, None] + np.arange(20)))
    bent[:, 1::4] = np.radians(3 * np.sin(3 * time[:, None] + np.arange(5)))
    bent[:, :4] *= 0.3
    angle = np.clip(bent, LIMITS_RAD[:, 0] + 0.02, LIMITS_RAD[:, 1] - 0.02)
    upright = vector_rotation(np.array([[np.pi, 0.0, 0.0]]))
    turn = upright @ vector_rotation(np.stack([0.2 * np.sin(4 * time), np.pi * time, 0.15 * np.sin(6 * time)], -1))
    place = np.stack(
        [0.01 * np.sin(4 * time) - 0.02, 0.09 + 0.01 * np.cos(3 * time), 0.22 + 0.01 * np.sin(5 * time)], -1
    )
    return Poses(turn, place, angle)


@cache
def film(count: int = 8, bones_sigma: float = 0.04, thickness: float = 0.6) -> Film:
    """bones_sigma: spread of the bones' lengths · thickness: of the first shape, and of one finger, in its units"""
    random = np.random.default_rng(3)
    factors = np.exp(bones_sigma * random.uniform(-1, 1, 20) * 3**0.5)
    other = rebuilt(np.zeros((1, 3)), bone_directions(CANONICAL_M[None]), bone_lengths(CANONICAL_M) * factors)[0]
    shape = np.zeros(SHAPE_COUNT)
    shape[[0, 4]] = thickness, -thickness
    poses = poses_of(count)
    joints = poses.joints_m(JointChain.of(other))
    camera = Camera(WIDTH, HEIGHT, FOCAL_PX, FOCAL_PX, WIDTH / 2, HEIGHT / 2, np.eye(4))
    renderer = HandRenderer(in_shape(PRIOR, shape), RenderSettings(threads=1))
    rgba = np.stack([renderer.render(one, camera).rgba for one in joints])
    flat = rgba[..., :3] + (1 - rgba[..., 3:]) * np.array([0.2, 0.35, 0.3])
    rgb_u8 = np.clip(255 * flat + 0.5, 0, 255).astype(np.uint8)
    return Film(camera, poses, joints, other, shape, rgb_u8, rgba[..., 3] > 0.5, np.arange(count) / FPS)
