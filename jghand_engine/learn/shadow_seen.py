"""How much the self-shadow of an avatar is ever seen: a shadow that nobody sees need not be drawn.

No useful bound follows from the shadow's gain and tint alone: they would allow several times what a hand's shape ever
brings about. So it is measured, by `jghand distill`, and the renderer reads it from the avatar's file.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.learned import ShadowLook
from jghand_engine.hand.poses import named_pose
from jghand_engine.hand.shapes import pose_names
from jghand_engine.learn.shadow import darken
from jghand_engine.native.library import load
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.render.shadow import ShadowStyle

# sides from which every pose is looked at: the faces and the corners of a cube
SIDES = tuple(
    side for side in itertools.product((-1.0, 0.0, 1.0), repeat=3) if sum(map(abs, side)) in (1.0, 3.0)
)  # fmt: skip
SIZE_PX = (256, 256)
# how much of the picture's height the hand's reach around its middle takes: the whole hand, and a close-up
FILLS = (0.9, 3.0)
SAMPLES = 32


def _darkest(renderer: HandRenderer, avatar: HandAvatar, joints_m: np.ndarray, camera: Camera) -> float:
    """Largest difference of a channel, 0..1, that the shadow of joints (21, 3) makes as if no gate ever closed it.
    renderer: of `avatar`, without shadow, with depth"""
    frame = renderer.render(joints_m, camera)
    look = ShadowLook() if avatar.learned is None else avatar.learned.shadow or ShadowLook()
    planes = torch.from_numpy(np.concatenate([frame.rgba, (frame.rgba[..., 3] * frame.depth_m)[..., None]], -1))
    planes = planes.permute(2, 0, 1).contiguous()
    style = ShadowStyle(gain=look.gain, tint=(1.0, 1.0, 1.0), samples=SAMPLES)
    visible = (darken(planes, camera, style, library=load()) / planes[:3].clamp_min(1e-6))[1].numpy()
    occlusion = np.where(frame.rgba[..., 3] > 0.5, 1 - visible, 0.0)
    shaded = frame.rgba[..., :3] * (1 - occlusion[..., None] * np.array(look.tint, np.float32))
    return float(np.abs(shaded - frame.rgba[..., :3]).max())


def with_shadow_seen(avatar: HandAvatar, tick: Callable[[float], None] = lambda part: None) -> HandAvatar:
    """The avatar with `ShadowLook.seen` measured; one that was learned without a shadow as it is."""
    if avatar.learned is None or avatar.learned.shadow is None:
        return avatar
    shadow = replace(avatar.learned.shadow, seen=shadow_seen(avatar, tick))
    return replace(avatar, learned=replace(avatar.learned, shadow=shadow))


def shadow_seen(avatar: HandAvatar, tick: Callable[[float], None] = lambda part: None) -> float:
    """0..1: the most that the whole shadow, of the usual reach, changes a channel of a pixel of the named poses, from
    all sides, whole and close up. tick: gets the part that is done."""
    renderer = HandRenderer(avatar, RenderSettings(shadow=ShadowMode.OFF, antialias=False))
    views = list(_views(avatar))
    darkest = 0.0
    for number, (joints_m, camera) in enumerate(views, start=1):
        darkest = max(darkest, _darkest(renderer, avatar, joints_m, camera))
        tick(number / len(views))
    return darkest


def _views(avatar: HandAvatar) -> Iterator[tuple[np.ndarray, Camera]]:
    width, height = SIZE_PX
    for name in pose_names():
        joints_m = named_pose(name, avatar.canonical_joints_m, handedness=avatar.handedness)
        middle = joints_m.mean(0)
        reach_m = float(np.linalg.norm(joints_m - middle, axis=1).max())
        # from far enough that the nearest finger is not much larger than the rest
        away_m = 6.0 * reach_m
        for side, fill in itertools.product(SIDES, FILLS):
            direction = np.array(side, np.float64)
            eye = middle + away_m * direction / np.linalg.norm(direction)
            up = (0.0, 0.0, 1.0) if abs(side[1]) == sum(map(abs, side)) else (0.0, 1.0, 0.0)
            focal_px = fill * height * away_m / (2 * reach_m)
            yield joints_m, Camera.looking_at(eye, middle, up, width=width, height=height, focal_px=focal_px)
