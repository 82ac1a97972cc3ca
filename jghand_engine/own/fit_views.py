"""What of a film's pictures a fit looks at: the hand with a margin, made smaller, and only this side of the wrist."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from jghand_engine.own.masks import hand_size_px, wrist_lines, wrist_side
from jghand_engine.render.camera import Camera

# about so long a hand is where a fit draws it, pixels: with 112 the outlines of a test film were 0.976, not 0.978
FIT_HAND_PX = 200
# around joints and mask, part of the hand's length
MARGIN_PART = 0.25


@dataclass(frozen=True)
class View:
    """A part of a picture, a whole number of times smaller.

    camera: of it, joints being in camera axes · left, top, width, height: of the part, pixels of the picture
    """

    camera: Camera
    left: int
    top: int
    width: int
    height: int

    @property
    def factor(self) -> int:
        """How many of the picture's pixels one of its own is wide."""
        return self.width // self.camera.width

    def cut(self, picture: np.ndarray) -> Tensor:
        """(h, w, ...) float32 of a picture (H, W, ...): every pixel the mean of those that it covers."""
        part = picture[self.top : self.top + self.height, self.left : self.left + self.width].astype(np.float32)
        camera, factor = self.camera, self.factor
        blocks = part.reshape(camera.height, factor, camera.width, factor, *part.shape[2:])
        return torch.from_numpy(blocks.mean((1, 3)))


def view_of(camera: Camera, low_px: np.ndarray, high_px: np.ndarray, factor: int) -> View:
    """The part of a picture between two corners (2,), made `factor` times smaller."""
    size = np.array([camera.width, camera.height]) // factor
    low = np.clip(np.floor(low_px / factor).astype(int), 0, size - 1)
    high = np.clip(np.ceil(high_px / factor).astype(int), low + 1, size)
    (left, top), (width, height) = low * factor, (high - low) * factor
    part = camera.part(int(left), int(top), int(width), int(height))
    return View(part.scaled(1 / factor), int(left), int(top), int(width), int(height))


def hand_side(camera: Camera, joints_m: np.ndarray) -> Tensor:
    """(h, w) how much of each pixel lies on the hand's side of the wrist, 0..1. joints_m: (21, 3) camera axes"""
    normal, limit = (line[0] for line in wrist_lines(camera.project(joints_m)[0][None]))
    x, y = np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5
    beyond = normal[0] * x + normal[1] * y[:, None] - limit
    return torch.from_numpy((0.5 - beyond).clip(0, 1).astype(np.float32))


@dataclass(frozen=True)
class Sight:
    """One picture as a fit sees it.

    view · rgb: (h, w, 3) 0..1 · mask: (h, w) 0..1 the hand · side: (h, w) 0..1 this side of the wrist
    inside: (h, w) 0 or 1, where the mask has no edge and the wrist is not near: there colors are the skin's
    """

    view: View
    rgb: Tensor
    mask: Tensor
    side: Tensor
    inside: Tensor


def sights(rgb_u8: np.ndarray, masks: np.ndarray, joints_m: np.ndarray, camera: Camera) -> list[Sight]:
    """Of pictures (F, H, W, 3) and masks (F, H, W), for joints (F, 21, 3) in camera axes. camera: of a whole picture"""
    joints_px = camera.project(joints_m)[0]
    size_px = hand_size_px(joints_px)
    # how many times smaller the pictures become
    factor, margin = max(1, round(float(np.median(size_px)) / FIT_HAND_PX)), MARGIN_PART * size_px
    masks = masks & wrist_side(joints_px, camera.width, camera.height)
    seen = []
    for row, (rgb, mask) in enumerate(zip(rgb_u8, masks, strict=True)):
        points = np.concatenate([joints_px[row], np.argwhere(mask)[:, ::-1]])
        view = view_of(camera, points.min(0) - margin[row], points.max(0) + margin[row], factor)
        small, side = view.cut(mask), hand_side(view.camera, joints_m[row])
        edge = functional.max_pool2d(1 - ((small > 0.99) & (side > 0.99)).float()[None], 3, 1, 1)[0]
        seen.append(Sight(view, view.cut(rgb) / 255, small, side, 1 - edge))
    return seen
