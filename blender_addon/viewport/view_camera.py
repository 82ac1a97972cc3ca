# SPDX-License-Identifier: GPL-3.0-or-later
"""A 3D view as the pinhole of the engine, and the engine's depth as the view's. Source: BLENDER 6 and 7.1."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import bpy
import numpy as np

from ..core.view import HandInSpace, Pinhole, pinhole_from

# an orthographic view of Blender has things behind its camera: the renderer's camera stands so far in front of the
# nearest joint, meters
ORTHO_ROOM_M = 0.5


@dataclass(frozen=True)
class ViewCamera:
    """The camera of a 3D view. whole: of the whole region, meters · window: (4, 4) Blender's projection matrix ·
    unit_m: meters per unit of the scene"""

    whole: Pinhole
    window: np.ndarray
    unit_m: float

    @property
    def parts(self) -> tuple[bytes | str, ...]:
        """What decides the picture, for a digest."""
        size = f"{self.whole.width}x{self.whole.height}, {self.unit_m!r}"
        return (size, self.whole.camera_from_world.tobytes(), self.window.tobytes())

    def in_front_of(self, hands: Sequence[HandInSpace]) -> tuple[Pinhole, float]:
        """The pinhole, moved back until it has the hands in front of it, and by how much, meters.

        An orthographic view of Blender's shows what is behind its camera as well; moving it changes nothing but depth.
        """
        if not self.whole.orthographic or not hands:
            return self.whole, 0.0
        nearest_m = min(self.whole.project(hand.joints_world_m)[:, 2].min() for hand in hands)
        room_m = max(0.0, ORTHO_ROOM_M - float(nearest_m))
        camera = self.whole.camera_from_world.copy()
        camera[2, 3] += room_m
        return replace(self.whole, camera_from_world=camera), room_m

    def clip_of_depth(self, room_m: float) -> tuple[float, float, float, float]:
        """(a, b, c, d) so that a point at the engine's depth z has clip depth a z + b over clip w c z + d."""
        per_m = 1.0 / self.unit_m
        a, c = -self.window[2, 2] * per_m, -self.window[3, 2] * per_m
        return a, self.window[2, 3] - a * room_m, c, self.window[3, 3] - c * room_m


def view_camera(region: bpy.types.Region, region_data: bpy.types.RegionView3D, unit_m: float) -> ViewCamera:
    """The camera of a 3D view as it is drawn now: perspective, orthographic, or through a camera object."""
    window = np.array(region_data.window_matrix, dtype=np.float64)
    view = np.array(region_data.view_matrix, dtype=np.float64)
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3], camera_from_world[:3, 3] = view[:3, :3], view[:3, 3] * unit_m
    size, orthographic = (region.width, region.height), bool(window[3, 3] == 1.0)
    whole = pinhole_from(window, camera_from_world, size, unit_m, orthographic=orthographic)
    return ViewCamera(whole, window, unit_m)
