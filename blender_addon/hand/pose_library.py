# SPDX-License-Identifier: GPL-3.0-or-later
"""The hand poses as Blender pose assets: a folder with one .blend file and its catalogs, used as an asset library.

The folder is made on demand by the Blender that uses it, and not shipped: it then has the file format and the kind of
actions of that Blender (4.5 to 5.2 differ in both), the package stays small and free of binaries, and a pose that is
corrected in the table reaches everybody with the next release. Making it took 3 s of one core (5.0.1), pictures most.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np

from .. import versions
from ..core import poses, posing
from ..core.controls import FINGER_CONTROLS, HAND_CONTROL
from ..core.joints import HANDEDNESSES
from ..core.poses import HandPose
from ..errors import JGHandFailure
from ..render.batch import write_whole
from . import pose_picture

LIBRARY_NAME = "JGHand"
BLEND = "jghand_poses.blend"
# Blender looks for this name in the folder of an asset library
CATALOG_FILE = "blender_assets.cats.txt"


def build_library(folder: Path) -> Path:
    """Writes the asset library into a folder, which is made; returns its .blend file. The open file stays as it is.

    Raises JGHandFailure: cannot_write, disk_full, bad_file.
    """
    for _ in library_steps(folder):
        pass
    return folder / BLEND


def library_steps(folder: Path) -> Iterator[float]:
    """The same in steps, each with the part that is done; whoever stops half-way leaves the open file as it was."""
    wanted = [pose for side in HANDEDNESSES for pose in poses.all_poses(side)]
    path = folder / BLEND
    moved = _move_away({pose.title for pose in wanted})
    made = []
    try:
        for pose in wanted:
            made.append(_asset(pose))
            yield len(made) / len(wanted)
        write_whole(folder / CATALOG_FILE, _catalogs().encode())
        bpy.data.libraries.write(str(path), set(made), fake_user=True, compress=True)
    except (OSError, RuntimeError) as error:
        raise JGHandFailure("cannot_write", f"{path}: {error}") from error
    finally:
        for action in made:
            bpy.data.actions.remove(action)
        for action, name in moved:
            action.name = name


def use_library(folder: Path) -> str:
    """Makes the folder one of the user's asset libraries, once. Returns the name that it has there: ours may be taken
    by a library of the user's."""
    libraries = bpy.context.preferences.filepaths.asset_libraries
    library = _library_at(folder) or libraries.new(name=LIBRARY_NAME, directory=str(folder))
    return library.name


def is_used(folder: Path) -> bool:
    """Whether the folder is one of the user's asset libraries."""
    return _library_at(folder) is not None


def _library_at(folder: Path) -> bpy.types.UserAssetLibrary | None:
    libraries = bpy.context.preferences.filepaths.asset_libraries
    return next((library for library in libraries if Path(library.path) == folder), None)


def _asset(pose: HandPose) -> bpy.types.Action:
    """An action of one frame with what the pose says, marked as an asset, with a picture."""
    curves = [
        (f'pose.bones["{bone}"].rotation_quaternion', index, part, bone)
        for bone, turn in pose.turns.items()
        for index, part in enumerate(turn)
    ]
    # a pose is what is seen: controls go back to neutral where there are any
    curves += [
        (f'pose.bones["{bone}"].rotation_euler', index, 0.0, bone)
        for bone in (HAND_CONTROL, *FINGER_CONTROLS)
        for index in (0, 2)
    ]
    action = versions.still_action(pose.title, curves)
    action.asset_mark()
    data = action.asset_data
    data.catalog_id = poses.CATALOGS[pose.handedness, pose.kind][0]
    data.description = pose.description or f"{pose.name.replace('_', ' ').capitalize()}, {pose.handedness} hand"
    data.author = "The JGHand authors"
    data.license = "GPL-3.0-or-later"
    for tag in ("hand", pose.handedness, *(("ASL",) if pose.kind == poses.LETTER else ())):
        data.tags.new(tag, skip_if_exists=True)
    _set_preview(action, pose)
    return action


def _set_preview(action: bpy.types.Action, pose: HandPose) -> None:
    rest = posing.rest_matrices(posing.rest_joints_m(pose.handedness), pose.handedness)
    picture = pose_picture.pose_picture(poses.posed_joints(rest, pose.quaternions))
    preview = action.preview_ensure()
    preview.image_size = (picture.shape[1], picture.shape[0])
    preview.image_pixels_float.foreach_set(picture[::-1].astype(np.float32).ravel())


def _move_away(titles: set[str]) -> list[tuple[bpy.types.Action, str]]:
    """Gives actions of the open file that have an asset's name another one for a while."""
    moved = []
    for action in list(bpy.data.actions):
        if action.library is None and action.name in titles:
            moved.append((action, action.name))
            action.name = f"{action.name} (open file)"
    return moved


def _catalogs() -> str:
    lines = ["# Catalogs of an asset library of Blender", "VERSION 1", ""]
    lines += [f"{identity}:{path}:{path.replace('/', '-')}" for identity, path in poses.CATALOGS.values()]
    return "\n".join(lines) + "\n"
