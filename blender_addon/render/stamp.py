# SPDX-License-Identifier: GPL-3.0-or-later
"""What the pictures of a folder were made from, so that a run never goes on among pictures of something else.

A small file beside the pictures holds hashes of what decides them. Pictures without one are of unknown origin.
Does not use bpy.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
from collections.abc import Iterable, Mapping
from pathlib import Path

from ..errors import JGHandFailure
from .batch import write_whole

NAME = ".jghand.json"
_PICTURE = re.compile(r"-?\d{3,}\.png")


def digest(paths: Iterable[Path]) -> str:
    """One hash of the contents of files: a copy of a file is the same, a later version of it is not."""
    whole = hashlib.sha256()
    for path in paths:
        try:
            with path.open("rb") as stream:
                whole.update(hashlib.file_digest(stream, "sha256").digest())
        except OSError as error:
            raise JGHandFailure("bad_file", f"{path}: {error.strerror or error}") from error
    return whole.hexdigest()


def settle(folder: Path, made_from: Mapping[str, str], replaced: Iterable[Path] | None = None) -> None:
    """Makes sure that all pictures of a folder are made from the same things, and stamps it with them.

    replaced: the pictures that a run makes anew whatever is there, None for a run that goes on. Where the folder holds
    pictures of something else, a run that goes on is refused; one that replaces them removes those that it replaces,
    and where others remain the folder loses its stamp, so that no later run takes them for its own.
    Raises JGHandFailure: other_pictures, cannot_write, disk_full.
    """
    pictures = {path for path in folder.glob("*.png") if _PICTURE.fullmatch(path.name)}
    before = _read(folder)
    if pictures and before != made_from:
        if replaced is None:
            raise JGHandFailure("other_pictures", f"{folder}: {_difference(before, made_from)}")
        old = pictures.intersection(replaced)
        _remove(old)
        if pictures - old:
            _remove([folder / NAME])
            return
    write_whole(folder / NAME, json.dumps(dict(made_from), indent=1).encode())


def _read(folder: Path) -> dict[str, str] | None:
    with contextlib.suppress(OSError, ValueError):
        content = json.loads((folder / NAME).read_text(encoding="utf-8"))
        return content if isinstance(content, dict) else None
    return None


def _difference(before: Mapping[str, str] | None, made_from: Mapping[str, str]) -> str:
    if before is None:
        return "it is not known what its pictures were made from"
    return "another " + ", ".join(name for name in made_from if before.get(name) != made_from[name])


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise JGHandFailure("cannot_write", f"{path}: {error.strerror or error}") from error
