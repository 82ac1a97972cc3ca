# SPDX-License-Identifier: GPL-3.0-or-later
"""Adding and removing classes of Blender so that doing it twice does no harm."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import bpy


def register_classes(classes: Sequence[type]) -> None:
    """Registers each class that is not registered yet, in order."""
    for each in classes:
        if not _is_registered(each):
            bpy.utils.register_class(each)


def unregister_classes(classes: Sequence[type]) -> None:
    """Removes each class that is registered, in the opposite order."""
    for each in reversed(classes):
        if _is_registered(each):
            bpy.utils.unregister_class(each)


def register_menu(menu: type[bpy.types.Menu], draw: Callable[[bpy.types.Menu, bpy.types.Context], None]) -> None:
    """Adds a line to a menu of Blender's, once."""
    menu.remove(draw)
    menu.append(draw)


def unregister_menu(menu: type[bpy.types.Menu], draw: Callable[[bpy.types.Menu, bpy.types.Context], None]) -> None:
    """Takes it away; nothing happens where it is not there."""
    menu.remove(draw)


def _is_registered(each: type) -> bool:
    return bool(getattr(each, "is_registered", False))
