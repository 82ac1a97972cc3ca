# SPDX-License-Identifier: GPL-3.0-or-later
"""Paths of hands that are appended from another file: `//` was the folder of that file, and Blender adapts only paths
of its own."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from .. import folders

_PATHS = ("avatar", "bake")


@persistent
def _appended(context: bpy.types.BlendImportContext, *_: object) -> None:
    for item in context.import_items:
        thing, source = item.id, item.source_library
        if isinstance(thing, bpy.types.Object) and thing.library is None and source is not None:
            for name in _PATHS:
                _adapt(thing, name, source)


def _adapt(thing: bpy.types.Object, name: str, source: bpy.types.Library) -> None:
    text = getattr(thing.jghand, name)
    if text.startswith("//"):
        whole = bpy.path.abspath(text, library=source)
        setattr(thing.jghand, name, folders.relative(whole) if bpy.data.filepath else whole)


def register() -> None:
    """Begins to look."""
    if _appended not in bpy.app.handlers.blend_import_post:
        bpy.app.handlers.blend_import_post.append(_appended)


def unregister() -> None:
    """Ends it."""
    if _appended in bpy.app.handlers.blend_import_post:
        bpy.app.handlers.blend_import_post.remove(_appended)
