# SPDX-License-Identifier: GPL-3.0-or-later
"""Cameras, hands in their own space, and the request for a picture of them. Source: BLENDER 3.2 and 6."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .wire import protocol

# the avatar that comes with the engine
BUILTIN_AVATAR = "builtin"
# avatars that the engine brings along, by name instead of file
SHIPPED_AVATARS = (BUILTIN_AVATAR, "painted")


@dataclass(frozen=True)
class Pinhole:
    """width, height, fx, fy, cx, cy: pixels, (0, 0) is the top-left corner; camera_from_world: (4, 4) rigid, metres,
    OpenCV axes (x right, y down, z forward)."""

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    camera_from_world: np.ndarray

    def project(self, points_m: np.ndarray) -> np.ndarray:
        """World points (..., 3), metres -> (..., 3): u and v in pixels, depth along the view axis in metres."""
        p = points_m @ self.camera_from_world[:3, :3].T + self.camera_from_world[:3, 3]
        z = p[..., 2]
        return np.stack([self.fx * p[..., 0] / z + self.cx, self.fy * p[..., 1] / z + self.cy, z], -1)


@dataclass(frozen=True)
class HandInSpace:
    """joints_m: (21, 3) in hand space, standard order, metres; world_from_hand: (4, 4) rigid, metres."""

    handedness: str
    joints_m: np.ndarray
    world_from_hand: np.ndarray
    avatar: str = BUILTIN_AVATAR

    @property
    def joints_world_m(self) -> np.ndarray:
        """(21, 3) in the world, metres."""
        return self.joints_m @ self.world_from_hand[:3, :3].T + self.world_from_hand[:3, 3]


def picture_request(
    pinhole: Pinhole, hands: Sequence[HandInSpace], *, preset: str, outputs: Sequence[str]
) -> tuple[dict[str, Any], dict[str, protocol.Array]]:
    """Header and arrays of a `render_picture` request: all hands of one view in one request."""
    header = {
        "kind": "render_picture",
        "width": pinhole.width,
        "height": pinhole.height,
        "fx": pinhole.fx,
        "fy": pinhole.fy,
        "cx": pinhole.cx,
        "cy": pinhole.cy,
        "preset": preset,
        "outputs": list(outputs),
        "hands": [{"avatar": hand.avatar, "handedness": hand.handedness} for hand in hands],
    }
    if not hands:
        return header, {}
    joints = np.stack([hand.joints_m for hand in hands]).astype("<f4")
    cameras = np.stack([pinhole.camera_from_world @ hand.world_from_hand for hand in hands]).astype("<f8")
    return header, {"joints": protocol.Array.of(joints), "camera_from_hand": protocol.Array.of(cameras)}
