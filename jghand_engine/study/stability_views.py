"""Hands drawn both ways from the same joints: what a reader sees of the study without reading a number."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.builtin import load_builtin
from jghand_engine.avatar.relighting import in_studio
from jghand_engine.export.pictures import flatten
from jghand_engine.hand.joints import Handedness
from jghand_engine.learn.baselines import transform_of
from jghand_engine.learn.gaussians import Gaussians
from jghand_engine.learn.rasterize import rasterize
from jghand_engine.learn.skinning import pose_gaussians
from jghand_engine.render.camera import Camera
from jghand_engine.study.stability_hands import NUDGE_M, abducted, bent_finger, posed
from jghand_engine.study.stability_measures import random_nudges
from jghand_engine.study.stability_pictures import converted
from jghand_engine.study.stability_usual import UsualTransform

# side of the hands drawn both ways
VIEW_PX = 300

_GROUND = (0.925, 0.92, 0.905)


@dataclass(frozen=True)
class ViewPair:
    """title: what is wrong with the joints · usual, ours: (H, W, 3) uint8"""

    title: str
    usual: np.ndarray
    ours: np.ndarray


def view_pairs() -> list[ViewPair]:
    """The pairs of the study's picture."""
    base = posed("flat")
    straight = base
    for finger in range(1, 5):
        straight = bent_finger(straight, finger, 0.0)
    nudge = NUDGE_M * random_nudges(8)[5]
    sideways = abducted(posed("open"), 4, math.radians(0.3), side=-1)
    far = posed("relaxed") + torch.tensor([2e4, 1.6e4, 1.6e4], dtype=torch.float64)
    return [
        _pair("Straight fingers, joints 0.5 mm off", straight + nudge, crossed=True),
        _pair("A finger sideways, joints 0.5 mm off", sideways + nudge),
        _pair("30 km from the scene's origin", far),
    ]


def _pair(title: str, joints_m: Tensor, *, crossed: bool = False) -> ViewPair:
    avatar = in_studio(load_builtin(handedness=Handedness.RIGHT))
    canonical_m = avatar.canonical_joints_m
    way = UsualTransform(canonical_m, handedness=Handedness.RIGHT, crossed=crossed)

    # what the pose changes beyond the bones is the same in both pictures
    bones = transform_of(avatar).bones((joints_m - joints_m[:1]).float())

    def ours() -> Gaussians:
        return pose_gaussians(avatar, bones, frames=bones.frames)

    def usual() -> Gaussians:
        gaussians = pose_gaussians(avatar, way.bones(joints_m.float()), frames=bones.frames)
        return replace(gaussians, position_m=gaussians.position_m - joints_m[0].float())

    return ViewPair(title, _drawn(usual, avatar), _drawn(ours, avatar))


def _drawn(make: Callable[[], Gaussians], avatar: HandAvatar) -> np.ndarray:
    """(H, W, 3) uint8 of a hand with its wrist at the origin, from the back, where the nails are."""
    side_px = VIEW_PX
    middle = np.array([0.01, 0.085, 0.0])
    eye = middle + np.array([-0.12, 0.1, -0.6])
    camera = Camera.looking_at(eye, middle, (0.0, 1.0, 0.0), width=side_px, height=side_px, focal_px=2.9 * side_px)
    with torch.no_grad():
        picture = rasterize(converted(make(), torch.float32), camera)
    rgba = torch.cat([picture.rgb, picture.alpha[..., None]], -1).numpy()
    return flatten(rgba, _GROUND)
