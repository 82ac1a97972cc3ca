"""The folder in which a training keeps what it needs to go on, and what it shows.

training.json   says that the folder is a training's, and with which options it began
lock            held while a training runs here
checkpoints/    step_00000500.safetensors: the last two and the best
log.jsonl       figures, a line per interval (see log.py); tensorboard/ the same for TensorBoard
pictures/       the first fixed view over time, truth beside ours; preview.jghand is the newest avatar
failures/       steps that gave values that are not finite, to be repeated (see guard.py)
"""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import save_avatar
from jghand_engine.captures.sample import Sample, picture_names
from jghand_engine.errors import InputError
from jghand_engine.export.pictures import to_bytes, write_png
from jghand_engine.files import check_place, file_error, make_folder, writing
from jghand_engine.learn.checkpoint import CheckpointFolder, Stamp
from jghand_engine.learn.trainable import Trainable
from jghand_engine.lock import locked

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

# held while a training runs in the folder; says with which options it began
LOCK, MARK = "lock", "training.json"


class Start(StrEnum):
    """new: the folder must hold no training · resume: go on where it stands · fresh: forget what it holds."""

    NEW = "new"
    RESUME = "resume"
    FRESH = "fresh"


def check_folder(path: Path, start: Start) -> None:
    """InputError when `path` holds something else than a training, or a training that `start` does not expect."""
    try:
        found = {entry.name for entry in path.iterdir()} if path.exists() else set()
    except OSError as error:
        raise file_error(path, error) from error
    # hidden files are what a kill left of one that was being written, or the file system's own
    names = {name for name in found if not name.startswith(".")} - {LOCK}
    if names and MARK not in names:
        raise InputError(
            f"{path}", wanted="a new or empty folder, or one of a training", came=f"one with {min(names)}",
            remedy="Name another folder with --work.",
        )  # fmt: skip
    if start is Start.RESUME and not names:
        raise InputError(f"{path}", wanted="a training to go on with", came="none", remedy="Leave out --resume.")
    if start is Start.NEW and names:
        raise InputError(
            f"{path}", wanted="a folder without a training", came="one that holds a training",
            remedy="Go on with it by --resume, forget it by --fresh, or name another folder with --work.",
        )  # fmt: skip


class WorkFolder:
    """The folder `path` of the training whose options are `stamp`."""

    def __init__(self, path: Path, stamp: Stamp) -> None:
        self.path, self._stamp = path, stamp
        self.checkpoints = CheckpointFolder(path / "checkpoints", stamp)
        self.log, self.board, self.failures = path / "log.jsonl", path / "tensorboard", path / "failures"

    @contextmanager
    def opened(self, start: Start) -> Iterator[None]:
        """Makes the folder this training's for the duration.

        InputError as `check_folder`; RetryError when another process trains there.
        """
        check_folder(self.path, start)
        make_folder(self.path)
        remedy = "Wait until it has ended, or name another folder with --work."
        with locked(self.path / LOCK, work="training", remedy=remedy):
            # again: another may have trained here meanwhile
            check_folder(self.path, start)
            self._remove_leftovers()
            if start is Start.FRESH:
                self._clear()
            if start is not Start.RESUME:
                content = {"jghand_training": __version__, "stamp": dict(self._stamp)}
                with writing(self.path / MARK) as temporary:
                    temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
            yield

    def _remove_leftovers(self) -> None:
        self.checkpoints.remove_leftovers()
        for path in self.path.glob(f".{Path(MARK).stem}.*{Path(MARK).suffix}"):
            path.unlink(missing_ok=True)

    def _clear(self) -> None:
        """Removes what a training leaves and nothing else, except the record of the output, which stays its own."""
        # the checkpoints first: should this break off, what is left goes on from its own beginning or not at all
        self.checkpoints.clear()
        for path in (self.log, self.path / "preview.jghand", *(self.path / "pictures").glob("step_*.png")):
            path.unlink(missing_ok=True)
        for folder in (self.board, self.failures):
            shutil.rmtree(folder, ignore_errors=True)


def stamp_of(options: DataclassInstance, pictures: Sequence[Sample]) -> dict[str, Any]:
    """Options (dataclasses of plain values) and which pictures are learned from, wherever their folder lies now."""
    lines = picture_names(pictures)
    digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
    # as it will be read back: tuples become lists, enumerations their text
    return json.loads(json.dumps({"pictures": len(lines), "which pictures": digest, "options": asdict(options)}))


class Output:
    """The file `path`. `record` remembers what this training wrote there, so that it may replace its own work.

    The record is written first and names both the file to come and the one before: whenever a process is killed, what
    lies at `path` is known.
    """

    def __init__(self, path: Path, record: Path, *, overwrite: bool = False) -> None:
        self.path, self._record, self._overwrite = path, record, overwrite

    def check(self) -> None:
        """InputError when a file is in the way that this training did not write, unless overwriting was asked for;
        errors as `check_place` where nothing can be written."""
        ours = self.path.is_file() and _hash(self.path) in self._recorded()
        wanted = "a new file, or the result of this very training"
        check_place(self.path, overwrite=self._overwrite or ours, wanted=wanted)

    def write(self, avatar: HandAvatar) -> None:
        """Saves `avatar`. Errors as `check`, which looks again: hours may have passed."""
        self.check()
        staged = self._record.with_name("finished.jghand")
        try:
            save_avatar(staged, avatar)
            content = staged.read_bytes()
            before = [_hash(self.path)] if self.path.is_file() else []
            self._remember([hashlib.sha256(content).hexdigest(), *before])
            with writing(self.path) as temporary:
                temporary.write_bytes(content)
        finally:
            staged.unlink(missing_ok=True)

    def _remember(self, hashes: list[str]) -> None:
        with writing(self._record) as temporary:
            temporary.write_text(json.dumps({"sha256": hashes}) + "\n", encoding="utf-8")

    def _recorded(self) -> list[str]:
        try:
            hashes = json.loads(self._record.read_text(encoding="utf-8"))["sha256"]
        except (OSError, ValueError, KeyError, TypeError):
            return []
        return hashes if isinstance(hashes, list) else [hashes]


def _hash(path: Path) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


class Previews:
    """pictures/step_00000500.png for every preview, and preview.jghand, always the newest, in one folder."""

    def __init__(self, folder: Path) -> None:
        self.pictures, self.avatar = folder / "pictures", folder / "preview.jghand"

    def write_picture(self, step: int, trainable: Trainable) -> Path:
        """Writes the first fixed view. InputError or RetryError when the disk does not let it."""
        path = self.pictures / f"step_{step:08d}.png"
        write_png(path, to_bytes(trainable.preview()))
        return path

    def write_avatar(self, trainable: Trainable) -> Path:
        """Writes the avatar over the last preview of it; errors as `write_picture`."""
        save_avatar(self.avatar, trainable.avatar())
        return self.avatar
