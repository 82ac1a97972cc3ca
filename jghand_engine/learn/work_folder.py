"""The folder in which a training keeps what it needs to go on, and what it shows.

training.json   says that the folder is a training's, with which options it began, and how long it is to last
lock            held while a training runs here
checkpoints/    step_00000500.safetensors: the last two and the best
log.jsonl       figures, a line per interval (see log.py)
pictures/       the first fixed view over time, truth beside ours; preview.jghand is the newest avatar
output.json     digest of the finished avatar that this training wrote, and may replace
"""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jghand_engine import __version__
from jghand_engine.avatar.avatar import HandAvatar
from jghand_engine.avatar.file import save_avatar
from jghand_engine.captures.sample import Sample, image_names
from jghand_engine.errors import InputError
from jghand_engine.files import check_place, file_error, make_folder, write_file
from jghand_engine.json_files import write_json
from jghand_engine.learn.checkpoint import CheckpointFolder, Stamp
from jghand_engine.learn.schedule import Budget
from jghand_engine.lock import locked

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

LOCK, MARK, OUTPUT = "lock", "training.json", "output.json"


class Start(StrEnum):
    """What the folder must hold."""

    NEW = "new"  # no training
    RESUME = "resume"  # one, which goes on
    FRESH = "fresh"  # anything a training left, which is forgotten


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
        raise InputError(f"{path}", wanted="a training to resume", came="none", remedy="Leave out --resume.")
    if start is Start.NEW and names:
        raise InputError(
            f"{path}", wanted="a folder without a training", came="one that holds a training",
            remedy="Resume it with --resume, restart it with --fresh, or name another folder with --work.",
        )  # fmt: skip


def remembered_budget(path: Path) -> Budget | None:
    """How long the training in the folder `path` was to last; None where that is not known."""
    told = _begun(path / MARK).get("budget")
    return Budget(told.get("steps"), told.get("seconds")) if isinstance(told, dict) else None


def _begun(mark: Path) -> dict[str, Any]:
    """What `mark` says of a training; nothing where it is missing or damaged."""
    try:
        content = json.loads(mark.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}


class WorkFolder:
    """The folder `path` of the training whose options are `stamp`, and which lasts for `budget`."""

    def __init__(self, path: Path, stamp: Stamp, budget: Budget) -> None:
        self.path, self._stamp, self._budget = path, stamp, budget
        self.checkpoints = CheckpointFolder(path / "checkpoints", stamp)
        self.log, self.pictures, self.preview = path / "log.jsonl", path / "pictures", path / "preview.jghand"

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
            # temporary files of `files.writing`, of a kill in the middle of a save
            left = ("checkpoints/.step_*.safetensors", f".{Path(MARK).stem}.*{Path(MARK).suffix}")
            for path in itertools.chain.from_iterable(map(self.path.glob, left)):
                path.unlink(missing_ok=True)
            if start is Start.FRESH:
                self._clear()
            if start is not Start.RESUME:
                self._write_mark({"jghand_training": __version__, "stamp": dict(self._stamp)})
            yield

    def remember_budget(self) -> None:
        """Lets a training that goes on last for this budget: to be called when its checkpoint was accepted, or options
        that are refused would change how long it lasts."""
        self._write_mark(_begun(self.path / MARK))

    def _write_mark(self, about: dict[str, Any]) -> None:
        write_json(self.path / MARK, {**about, "budget": asdict(self._budget)})

    def _clear(self) -> None:
        """Removes what a training leaves and nothing else, but for output.json: the avatar stays its own."""
        # the checkpoints first: should this break off, what is left goes on from its own beginning or not at all
        self.checkpoints.clear()
        for path in (self.log, self.preview, *self.pictures.glob("step_*.png")):
            path.unlink(missing_ok=True)


def stamp_of(options: DataclassInstance, pictures: Sequence[Sample]) -> dict[str, Any]:
    """Options (dataclasses of plain values) and which pictures are learned from, wherever their folder lies now."""
    lines = image_names(pictures)
    digest = hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]
    # as it will be read back: tuples become lists, enumerations their text
    return json.loads(json.dumps({"pictures": len(lines), "which pictures": digest, "options": asdict(options)}))


def check_output(path: Path, work: Path, *, overwrite: bool) -> None:
    """InputError when a file is in the way that the training in `work` did not write, unless overwriting was asked for;
    errors as `check_place` where nothing can be written."""
    ours = path.is_file() and _hash(path) in _written(work / OUTPUT)
    check_place(path, overwrite=overwrite or ours, wanted="a new file, or the result of this very training")


def write_output(path: Path, work: Path, avatar: HandAvatar) -> None:
    """Saves the finished avatar, and what it is known by when the training writes it again."""
    save_avatar(path, avatar)
    write_file(work / OUTPUT, json.dumps({"sha256": [_hash(path)]}) + "\n")


def _written(record: Path) -> list[str]:
    try:
        return list(json.loads(record.read_text(encoding="utf-8"))["sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _hash(path: Path) -> str:
    with open(path, "rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
