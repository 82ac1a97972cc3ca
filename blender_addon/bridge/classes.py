# SPDX-License-Identifier: GPL-3.0-or-later
"""Adding and removing classes of Blender so that doing it twice does no harm."""

from __future__ import annotations

from collections.abc import Sequence

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


def _is_registered(each: type) -> bool:
    return bool(getattr(each, "is_registered", False))
