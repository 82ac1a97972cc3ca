"""Finding a data set near the folder that a user named: people unpack archives a level too deep, or name `images`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from jghand_engine.errors import InputError

# folders between the one that the user names and the one that holds the set, upwards and downwards
FOLDER_LEVELS_UP = 6
FOLDER_LEVELS_DOWN = 2


def find_roots(folder: Path, is_root: Callable[[Path], bool]) -> list[Path]:
    """The folders that hold a data set: `folder` itself, or else the nearest above it, or else those nearest below.

    InputError when `folder` is not there. Folders that cannot be looked into, such as a disk's lost+found, hold none.
    """
    if not folder.is_dir():
        came = "a file" if folder.exists() else "no such folder"
        raise InputError(f"data set {folder}", wanted="a folder", came=came, remedy="Check the name.")
    inside = folder.resolve()
    for candidate in [inside, *list(inside.parents)[:FOLDER_LEVELS_UP]]:
        if _holds(is_root, candidate):
            return [candidate]
    level = [inside]
    for _ in range(FOLDER_LEVELS_DOWN):
        level = [below for above in level for below in subfolders(above)]
        found = [candidate for candidate in level if _holds(is_root, candidate)]
        if found:
            return found
    return []


def _holds(is_root: Callable[[Path], bool], folder: Path) -> bool:
    try:
        return is_root(folder)
    except OSError:
        return False


def subfolders(folder: Path) -> list[Path]:
    """The folders in a folder, sorted; none where it cannot be looked into."""
    try:
        return sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError:
        return []


def one_root(folder: Path, roots: list[Path]) -> Path:
    """The only one of `roots`. InputError when there are several."""
    if len(roots) > 1:
        names = ", ".join(str(root.relative_to(folder.resolve())) for root in roots)
        raise InputError(
            f"data set {folder}",
            wanted="one data set",
            came=f"{len(roots)} inside: {names}",
            remedy="Name the folder of one of them.",
        )
    return roots[0]
