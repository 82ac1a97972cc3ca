# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the extension may write, and paths of hands: `//` is the folder of the file that a text was written for."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from .errors import JGHandFailure

# properties of a hand that are paths
_PATHS = ("avatar", "bake")


def user_folder(name: str, *, make: bool = True) -> Path:
    """A folder of the extension, made when it is not there, or only its path. JGHandFailure: cannot_write.

    Used without being installed as an extension, the package has none; then Blender's folder for data serves.
    """
    try:
        return Path(bpy.utils.extension_path_user(__package__, path=name, create=make))
    except ValueError:
        found = bpy.utils.user_resource("DATAFILES", path=str(Path("jghand") / name), create=make)
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{name}: {error.strerror or error}") from error
    if not found:
        raise JGHandFailure("cannot_write", f"{name}: Blender has no folder for this user")
    return Path(found)


def job_folder() -> Path:
    """A new folder for what one job is given and says: no other Blender uses it. JGHandFailure: cannot_write."""
    try:
        return Path(tempfile.mkdtemp(prefix="job_", dir=user_folder("jobs")))
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{error.filename}: {error.strerror or error}") from error


def absolute(thing: bpy.types.Object, name: str) -> str:
    """A path of a hand's settings, absolute: // is the folder of the file that the text was written for. An override
    that leaves it as it is has it from its library. "" where there is none."""
    text, library = getattr(thing.jghand, name), thing.library
    if text.startswith("//") and library is None and bpy.data.libraries:
        override = thing.original.override_library  # evaluated objects do not know what they override
        reference = override.reference if override is not None else None
        if reference is not None and getattr(reference.jghand, name) == text:
            library = reference.library
    return bpy.path.abspath(text, library=library) if text else ""


def beside_the_file(context: bpy.types.Context, folder: Path) -> str:
    """The folder of a bake as it is kept: relative to the file where its settings are so, so that both can be given
    away together."""
    if context.blend_data.filepath and context.scene.jghand.output.bake_folder.startswith("//"):
        return relative(str(folder))
    return str(folder)


def relative(path: str) -> str:
    """A path as seen from the opened file; on another drive it stays as it is."""
    try:
        return bpy.path.relpath(path)
    except ValueError:
        return path


# ---- hands that are appended from another file: Blender adapts only paths of its own ---------------------------------


@persistent
def _appended(context: bpy.types.BlendImportContext, *_: object) -> None:
    for item in context.import_items:
        thing, source = item.id, item.source_library
        if isinstance(thing, bpy.types.Object) and thing.library is None and source is not None:
            for name in _PATHS:
                if (text := getattr(thing.jghand, name)).startswith("//"):
                    whole = bpy.path.abspath(text, library=source)
                    setattr(thing.jghand, name, relative(whole) if bpy.data.filepath else whole)


APP_HANDLERS = (("blend_import_post", _appended),)
