# SPDX-License-Identifier: GPL-3.0-or-later
"""Where the extension may write: its own folder of this user, which Blender names."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..core.messages import JGHandFailure

_PACKAGE = __package__.rpartition(".")[0]


def user_folder(name: str, *, make: bool = True) -> Path:
    """A folder of the extension, made when it is not there, or only its path. JGHandFailure: cannot_write.

    Used without being installed as an extension, the package has none; then Blender's folder for data serves.
    """
    try:
        return Path(bpy.utils.extension_path_user(_PACKAGE, path=name, create=make))
    except ValueError:
        found = bpy.utils.user_resource("DATAFILES", path=str(Path("jghand") / name), create=make)
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{name}: {error.strerror or error}") from error
    if not found:
        raise JGHandFailure("cannot_write", f"{name}: Blender has no folder for this user")
    return Path(found)
