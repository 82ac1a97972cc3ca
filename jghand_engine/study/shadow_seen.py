"""How much the self-shadow of an avatar is ever seen: a shadow that nobody sees need not be drawn.

No useful bound follows from the shadow's gain and tint alone: they would allow several times what a hand's shape ever
brings about. So it is measured, by `jghand distill`, and the renderer reads it from the avatar's file.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.hand.poses import named_pose, pose_names
from jghand_engine.render.camera import Camera
from jghand_engine.render.renderer import HandRenderer
from jghand_engine.render.settings import RenderSettings, ShadowMode
from jghand_engine.study.effects_study import gate_row

# sides from which every pose is looked at: the faces and the corners of a cube
SIDES = tuple(
    side for side in itertools.product((-1.0, 0.0, 1.0), repeat=3) if sum(map(abs, side)) in (1.0, 3.0)
)  # fmt: skip
SIZE_PX = (256, 256)
# how much of the picture's height the hand's reach around its middle takes: the whole hand, and a close-up
FILLS = (0.9, 3.0)


def with_shadow_seen(avatar: HandAvatar, tick: Callable[[float], None] = lambda part: None) -> HandAvatar:
    """The avatar with `ShadowLook.seen` measured; one that was learned without a shadow as it is."""
    if avatar.learned is None or avatar.learned.shadow is None:
        return avatar
    shadow = replace(avatar.learned.shadow, seen=shadow_seen(avatar, tick))
    return replace(avatar, learned=replace(avatar.learned, shadow=shadow))


def shadow_seen(avatar: HandAvatar, tick: Callable[[float], None] = lambda part: None) -> float:
    """0..1: the most that the whole shadow, of the usual reach, changes a channel of a pixel of the named poses, from
    all sides, whole and close up. tick: gets the part that is done."""
    renderer = HandRenderer(avatar, RenderSettings(shadow=ShadowMode.OFF))
    views = list(_views(avatar))
    darkest = 0.0
    for number, view in enumerate(views, start=1):
        darkest = max(darkest, gate_row(renderer, avatar, view).darkest)
        tick(number / len(views))
    return darkest


def _views(avatar: HandAvatar) -> Iterator[tuple[str, np.ndarray, Camera]]:
    width, height = SIZE_PX
    for name in pose_names():
        joints_m = named_pose(name, avatar.canonical_joints_m, handedness=avatar.handedness)
        middle = joints_m.mean(0)
        reach_m = float(np.linalg.norm(joints_m - joints_m.mean(0), axis=1).max())
        for side, fill in itertools.product(SIDES, FILLS):
            direction = np.array(side, np.float64)
            # from far enough that the nearest finger is not much larger than the rest
            away_m = 6.0 * reach_m
            eye = middle + away_m * direction / np.linalg.norm(direction)
            up = (0.0, 0.0, 1.0) if abs(side[1]) == sum(map(abs, side)) else (0.0, 1.0, 0.0)
            focal_px = fill * height * away_m / (2 * reach_m)
            camera = Camera.looking_at(eye, middle, up, width=width, height=height, focal_px=focal_px)
            yield name, joints_m, camera
