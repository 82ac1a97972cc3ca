# SPDX-License-Identifier: GPL-3.0-or-later
"""Who writes into a folder that several files may share: the opened file, and which of its hands."""

from __future__ import annotations

import os
import uuid
from pathlib import Path

import bpy

# tells files apart that were never saved
_SESSION = uuid.uuid4().hex


def owner_in(folder: Path, hand: str) -> str:
    """The owner of what a hand of the opened file writes into a folder. The file is named as it is seen from there: two
    of one name in different places are two, and a project that is moved as a whole stays its own."""
    return f"{_file_from(folder)}:{hand}"


def _file_from(folder: Path) -> str:
    path = bpy.data.filepath
    if not path:
        return f"unsaved {_SESSION}"
    try:
        return Path(os.path.relpath(path, folder)).as_posix()
    except ValueError:  # another drive
        return Path(path).as_posix()
