# SPDX-License-Identifier: GPL-3.0-or-later
"""The part of a view that can show hands, and the picture of that part: what is empty is neither drawn nor sent."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from . import limits
from .view import HandInSpace, Pinhole

_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), -1).reshape(-1, 3) * limits.REACH_M


@dataclass(frozen=True)
class Part:
    """A rectangle of a view in whole pixels; (left, top) is inside, (right, bottom) just outside; y goes down."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def width(self) -> int:
        return self.right - self.left

    @property
    def height(self) -> int:
        return self.bottom - self.top

    @property
    def pixels(self) -> int:
        return self.width * self.height


def part_with(view: Pinhole, hands: Sequence[HandInSpace]) -> Part | None:
    """The part of a view outside which no hand can be; None when none can be seen."""
    if not hands:
        return None
    joints_m = np.concatenate([hand.joints_world_m for hand in hands])
    points = view.project((joints_m[:, None] + _CORNERS).reshape(-1, 3))
    near_m = -math.inf if view.orthographic else limits.CLIP_START_M
    if (points[:, 2] <= near_m).all():
        return None
    if (points[:, 2] <= near_m).any():  # what is beside the camera can be anywhere in the view
        return Part(0, 0, view.width, view.height)
    step = limits.CROP_STEP_PX
    size = np.array([view.width, view.height])
    # far outside the view the numbers may be beyond what an integer holds
    first = np.clip(np.floor(points[:, :2].min(0) / step) * step, 0, size).astype(int)
    last = np.clip(np.ceil(points[:, :2].max(0) / step) * step, 0, size).astype(int)
    if (last <= first).any():
        return None
    return Part(int(first[0]), int(first[1]), int(last[0]), int(last[1]))


def picture_of(view: Pinhole, part: Part, pixels_max: int) -> Pinhole:
    """The camera of the picture of a part of a view, made smaller where it has more pixels than that."""
    scale = min(1.0, math.sqrt(pixels_max / part.pixels))
    width, height = max(1, round(part.width * scale)), max(1, round(part.height * scale))
    across, down = width / part.width, height / part.height
    return replace(
        view,
        width=width,
        height=height,
        fx=view.fx * across,
        fy=view.fy * down,
        cx=(view.cx - part.left) * across,
        cy=(view.cy - part.top) * down,
    )
