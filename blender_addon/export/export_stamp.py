# SPDX-License-Identifier: GPL-3.0-or-later
"""Whose an export is: several files may export into one folder, and none silently writes over what another made.

Beside the files of an export lies a small one that names its owner; it is written before the first of them, so that
two Blenders do not both take the name. What is there without one is of unknown origin, so it is somebody else's.
Does not use bpy.
"""

from __future__ import annotations

import contextlib
import json
import re
from pathlib import Path

from ..core import limits
from ..core.files import write_whole
from ..errors import JGHandFailure

_FORMAT, _VERSION = "jghand export", 1
# what an export of a format and name is known by
_FILES = {"usd": "{name}.usda", "motion": "{name}.npz"}


def stamp_path(folder: Path, name: str, kind: str) -> Path:
    """Where the owner of an export is written down. kind: usd, ply or motion."""
    return folder / f".{name}.{kind}.json"


def check(folder: Path, name: str, kind: str, owner: str) -> None:
    """JGHandFailure: other_export where an export of this name lies that is not of this owner."""
    there = _there(folder, name, kind)
    if there is None:
        return
    other = _owner(folder, name, kind)
    if other != owner:
        who = f"of {other}" if other else "and it is not known who made it"
        raise JGHandFailure("other_export", f"{there} is there, {who}")


def claim(folder: Path, name: str, kind: str, owner: str) -> None:
    """Makes the name this owner's. JGHandFailure: cannot_write, disk_full."""
    content = {"format": _FORMAT, "version": _VERSION, "owner": owner}
    write_whole(stamp_path(folder, name, kind), json.dumps(content, indent=1).encode())


def _there(folder: Path, name: str, kind: str) -> Path | None:
    """A file of the export; None where there is none."""
    if kind in _FILES:
        path = folder / _FILES[kind].format(name=name)
        return path if path.exists() else None
    numbered = re.compile(re.escape(name) + r"\.-?\d{4,}\.ply")
    with contextlib.suppress(OSError):
        return next((path for path in sorted(folder.iterdir()) if numbered.fullmatch(path.name)), None)
    return None


def _owner(folder: Path, name: str, kind: str) -> str:
    """Who made an export; "" where that is not known."""
    path = stamp_path(folder, name, kind)
    try:
        if path.stat().st_size > limits.STAMP_MAX_BYTES:
            return ""
        content = json.loads(path.read_text(encoding="utf-8"))
        return str(content["owner"]) if content["format"] == _FORMAT else ""
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return ""
