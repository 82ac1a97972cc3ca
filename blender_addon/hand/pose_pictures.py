# SPDX-License-Identifier: GPL-3.0-or-later
"""Small pictures of the poses for menus, made one at a time beside Blender's own work, when they are first asked for.

All of them take over a second, so a timer makes one or two per turn and rests while an animation plays. Without a
window there are no icons, and none are made.
"""

from __future__ import annotations

import time

import bpy
import bpy.utils.previews

from .. import clock
from ..core import limits, poses, posing
from ..core.joints import HANDEDNESSES, RIGHT
from ..ui import redraw, store_picture
from . import pose_picture

_icons: bpy.utils.previews.ImagePreviewCollection | None = None
_waiting: list[str] = []


def icon_of(name: str, handedness: str) -> int:
    """Blender's number of a pose's picture; 0 before all are made."""
    return _icons[_key(name, handedness)].icon_id if _icons is not None and are_made() else 0


def are_made() -> bool:
    """Whether there is a picture of every pose."""
    return _icons is not None and not _waiting


def ask() -> None:
    """Starts the making, unless it is done, under way, or of no use."""
    global _icons
    if bpy.app.background:
        return
    if _icons is None:
        _icons = bpy.utils.previews.new()
        _waiting.extend(pose.name for pose in poses.all_poses(RIGHT))
    if _waiting and not bpy.app.timers.is_registered(_make_some):
        bpy.app.timers.register(_make_some, first_interval=limits.PICTURE_REST_S, persistent=True)


def register() -> None:
    """Nothing is made before it is asked for."""


def unregister() -> None:
    """Frees the pictures."""
    global _icons
    if bpy.app.timers.is_registered(_make_some):
        bpy.app.timers.unregister(_make_some)
    _waiting.clear()
    if _icons is not None:
        bpy.utils.previews.remove(_icons)
        _icons = None


@clock.guarded(limits.PICTURE_REST_S)
def _make_some() -> float | None:
    """The timer: as many poses as fit into a turn, one at the least; None when all are there."""
    ends = time.monotonic() + limits.PICTURE_TURN_S
    if any(window.screen.is_animation_playing for window in bpy.context.window_manager.windows):
        return limits.PICTURE_PAUSE_S
    while _waiting and _icons is not None:
        _make(_waiting.pop(0))
        if time.monotonic() > ends:
            break
    if _waiting:
        return limits.PICTURE_REST_S
    redraw()
    return None


def _make(name: str) -> None:
    """The pictures of one pose, right and left."""
    rest = posing.rest_matrices(posing.rest_joints_m(RIGHT), RIGHT)
    turns = poses.pose_named(name, RIGHT).quaternions
    picture = pose_picture.pose_picture(poses.posed_joints(rest, turns), limits.MENU_PICTURE_PX)
    for handedness in HANDEDNESSES:
        store_picture(_icons, _key(name, handedness), picture if handedness == RIGHT else picture[:, ::-1])


def _key(name: str, handedness: str) -> str:
    return f"{name} {handedness}"
