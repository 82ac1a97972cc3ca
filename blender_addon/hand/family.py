# SPDX-License-Identifier: GPL-3.0-or-later
"""The hands that Add Hand offers by picture: those that come with JGHand, and those of packs that were installed."""

from __future__ import annotations

from pathlib import Path

import bpy
import bpy.utils.previews
from bpy_extras.io_utils import ImportHelper

from .. import folders
from ..core.view import BUILTIN_AVATAR
from ..errors import JGHandFailure
from ..ops import REGISTERED, Reporting
from . import avatar_files
from .seen_hands import HANDS, hand_folders

# Blender keeps no texts of dynamic items, nor their pictures
_items: list[tuple[str, str, str, int, int]] = []
_pictures: list[bpy.utils.previews.ImagePreviewCollection] = []


def items(_owner: object = None, _context: bpy.types.Context | None = None) -> list[tuple[str, str, str, int, int]]:
    """Of an enumeration: the built-in hand, then the others. Their numbers hold until hands are installed."""
    found = [(BUILTIN_AVATAR, "Built-in", "The hand that comes with JGHand", icon_of(_picture_of(BUILTIN_AVATAR)), 0)]
    for place, hand in enumerate(avatar_files.hands_in(hand_folders()), 1):
        found.append((hand.name, hand.title, str(hand.file), icon_of(hand.picture), place))
    if found != _items:
        _items[:] = found
    return _items


def _picture_of(name: str) -> Path | None:
    paths = (folder / f"{name}{avatar_files.PICTURE}" for folder in hand_folders())
    return next((path for path in paths if path.is_file()), None)


def icon_of(picture: Path | None) -> int:
    """Of a picture as its file is now; 0 for none."""
    if picture is None or not picture.is_file():
        return 0
    if not _pictures:
        _pictures.append(bpy.utils.previews.new())
    (loaded,) = _pictures
    key = f"{picture} {picture.stat().st_mtime_ns}"
    return (loaded[key] if key in loaded else loaded.load(key, str(picture), "IMAGE")).icon_id


class JGHandChoice(bpy.types.PropertyGroup):
    """`window_manager.jghand`: what Add Hand adds next; not saved with the file."""

    hand: bpy.props.EnumProperty(name="Hand", description="The hand that Add Hand adds", items=items)


class InstallHands(Reporting, ImportHelper, bpy.types.Operator):
    bl_idname = "jghand.install_hands"
    bl_label = "Install Hands"
    bl_description = "Choose a zip of hands: they are offered by Add Hand from then on, in every file"
    bl_options = REGISTERED

    filename_ext = ".zip"
    filter_glob: bpy.props.StringProperty(default="*.zip", options={"HIDDEN"})

    def run(self, _context: bpy.types.Context) -> None:
        path = Path(bpy.path.abspath(self.filepath))
        if not path.is_file():
            raise JGHandFailure("bad_pack", str(path))
        names, broken = avatar_files.unpack(path, folders.user_folder(HANDS))
        doubts = [f"Damaged, and left out: {', '.join(broken)}. Get the zip again."] if broken else []
        self.tell(f"Installed hands: {', '.join(names) or '0'}.", doubts=doubts)


CLASSES = (JGHandChoice, InstallHands)
SETTINGS = ((bpy.types.WindowManager, JGHandChoice),)


def unregister() -> None:
    while _pictures:
        bpy.utils.previews.remove(_pictures.pop())
