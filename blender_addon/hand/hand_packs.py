# SPDX-License-Identifier: GPL-3.0-or-later
"""Hands that are chosen by picture: files NAME.jghand beside NAME.png, in a folder or in a zip. Does not use bpy.

A hand of a name is found wherever its file lies, so that a scene that has the name is the same on another machine.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from ..errors import JGHandFailure
from .avatar_files import card_of, read_card

SUFFIX, PICTURE = ".jghand", ".png"
# bytes of a file in a zip: five times the largest hand that JGHand makes
FILE_MAX_BYTES = 40_000_000
_NAME = re.compile(r"[a-z0-9][a-z0-9_-]{0,40}")


@dataclass(frozen=True)
class PackedHand:
    """name: as scenes have it · file: the avatar · picture: None where it has none"""

    name: str
    file: Path
    picture: Path | None

    @property
    def title(self) -> str:
        """For people."""
        return self.name.replace("_", " ").capitalize()


def is_name(text: str) -> bool:
    """Whether it names a hand, and is no path."""
    return _NAME.fullmatch(text) is not None


def name_of_film(film: Path) -> str:
    """The name of the hand in somebody's film: none of a hand that comes with JGHand."""
    return "my_" + re.sub(r"[^a-z0-9_-]", "_", film.stem.lower())[:38]


def hands_in(folders: Iterable[Path]) -> list[PackedHand]:
    """Those in these folders whose files can be read, in the order of their names; the first of a name counts."""
    found: dict[str, PackedHand] = {}
    for folder in folders:
        for file in sorted(folder.glob(f"*{SUFFIX}")) if folder.is_dir() else ():
            if file.stem in found or not is_name(file.stem) or not _is_read(partial(card_of, str(file))):
                continue
            picture = file.with_suffix(PICTURE)
            found[file.stem] = PackedHand(file.stem, file, picture if picture.is_file() else None)
    return [found[name] for name in sorted(found)]


def unpack(path: Path, folder: Path) -> tuple[list[str], list[str]]:
    """Puts the hands of a zip into a folder: their names, and the files that are none and were left out.

    A hand of the same name is replaced. JGHandFailure: bad_pack, for no zip or one without hands; cannot_write.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            entries = {Path(info.filename).name: info for info in archive.infolist() if _is_wanted(info)}
            files = [name for name in sorted(entries) if name.endswith(SUFFIX)]
            if not files:
                raise JGHandFailure("bad_pack", str(path))
            broken = [name for name in files if not _unpacked(archive, entries, Path(name), folder)]
    except (zipfile.BadZipFile, NotImplementedError, EOFError) as error:
        raise JGHandFailure("bad_pack", f"{path}\n{str(error)[:200]}") from error
    except OSError as error:
        raise JGHandFailure("cannot_write", f"{folder}: {error.strerror or error}") from error
    return [Path(name).stem for name in files if name not in broken], broken


def _is_wanted(info: zipfile.ZipInfo) -> bool:
    name = Path(info.filename)
    return is_name(name.stem) and name.suffix in (SUFFIX, PICTURE) and info.file_size <= FILE_MAX_BYTES


def _unpacked(archive: zipfile.ZipFile, entries: dict[str, zipfile.ZipInfo], name: Path, folder: Path) -> bool:
    """Whether a hand is one, and now lies in the folder with its picture: whole or not at all."""
    for file in (name, name.with_suffix(PICTURE)):
        if file.name not in entries:
            continue
        draft = folder / f"{file.name}.new"
        try:
            draft.write_bytes(archive.read(entries[file.name]))
            if file.suffix == SUFFIX and not _is_read(partial(read_card, draft)):
                return False
            draft.replace(folder / file.name)
        except zipfile.BadZipFile:  # its checksum is another
            return False
        finally:
            draft.unlink(missing_ok=True)
    return True


def _is_read(read: Callable[[], object]) -> bool:
    """Whether the file of an avatar is one, as far as its card says; the renderer reads all of it."""
    try:
        read()
    except JGHandFailure:
        return False
    return True
