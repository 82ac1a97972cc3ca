# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand poses as Blender pose assets: `assets/poses`, a shipped folder with one .blend file and its catalogs.

`scripts/build_pose_library.py` makes it. The extension only adds it to the user's asset libraries, and shows Blender's
own shelf of it.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from .. import clock

FOLDER = Path(__file__).resolve().parents[1] / "assets" / "poses"
LIBRARY_NAME = "JGHand"
BLEND = "jghand_poses.blend"
# Blender looks for this name in the folder of an asset library
CATALOG_FILE = "blender_assets.cats.txt"
# a view has the shelf once it was drawn in pose mode: how often, seconds, and how many times that is waited for
_SHELF_S, _SHELF_TRIES = 0.2, 10

_tries_left = 0


def use_library() -> str:
    """Makes the folder one of the user's asset libraries, once. Returns the name that it has there: ours may be taken
    by a library of the user's."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    library = _library() or libraries.new(name=LIBRARY_NAME, directory=str(FOLDER))
    return library.name


def is_used() -> bool:
    """Whether the folder is one of the user's asset libraries."""
    return _library() is not None


def show_shelf() -> None:
    """Shows the asset shelf in the views of the screen that is looked at, as soon as they have one."""
    global _tries_left
    if bpy.app.background:
        return
    _tries_left = _SHELF_TRIES
    if not bpy.app.timers.is_registered(_try_to_show):
        bpy.app.timers.register(_try_to_show, first_interval=_SHELF_S)


def register() -> None:
    """Nothing happens before it is asked for."""


def unregister() -> None:
    """Stops trying."""
    if bpy.app.timers.is_registered(_try_to_show):
        bpy.app.timers.unregister(_try_to_show)


def _library() -> bpy.types.UserAssetLibrary | None:
    libraries = bpy.context.preferences.filepaths.asset_libraries
    return next((library for library in libraries if Path(library.path) == FOLDER), None)


@clock.guarded(None)
def _try_to_show() -> float | None:
    global _tries_left
    _tries_left -= 1
    spaces = [
        area.spaces.active
        for window in bpy.context.window_manager.windows
        for area in window.screen.areas
        if area.type == "VIEW_3D"
    ]
    ready = [space for space in spaces if not space.is_property_readonly("show_region_asset_shelf")]
    for space in ready:
        space.show_region_asset_shelf = True
    return _SHELF_S if len(ready) < len(spaces) and _tries_left > 0 else None
