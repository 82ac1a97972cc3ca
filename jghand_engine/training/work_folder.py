"""The folder in which a training keeps what it needs to go on, and what it shows.

training.json   says that the folder is a training's, and with which options it began
lock            held while a training runs here
checkpoints/    step_00000500.safetensors: the last two and the best
log.jsonl       figures, a line per interval (see log.py); tensorboard/ the same for TensorBoard
pictures/       the fixed view over time, truth beside ours; preview.jghand is the newest avatar
failures/       steps that gave values that are not finite, to be repeated (see guard.py)
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path

from jghand_engine import __version__
from jghand_engine.errors import InputError
from jghand_engine.files import file_error, make_folder, writing
from jghand_engine.training.checkpoint import CheckpointFolder, Stamp
from jghand_engine.training.lock import locked

LOCK, MARK = "lock", "training.json"


class Start(StrEnum):
    """new: the folder must hold no training · resume: go on where it stands · fresh: forget what it holds."""

    NEW = "new"
    RESUME = "resume"
    FRESH = "fresh"


class WorkFolder:
    """The folder `path` of the training whose options are `stamp`."""

    def __init__(self, path: Path, stamp: Stamp) -> None:
        self.path, self._stamp = path, stamp
        self.checkpoints = CheckpointFolder(path / "checkpoints", stamp)
        self.log, self.board, self.failures = path / "log.jsonl", path / "tensorboard", path / "failures"
        self.output_record = path / "output.json"

    @contextmanager
    def opened(self, start: Start) -> Iterator[None]:
        """Makes the folder this training's for the duration.

        InputError when it holds something else, or a training that `start` does not expect; RetryError when another
        process trains there.
        """
        self._refuse_foreign_files()
        if start is Start.RESUME and not self._mark.exists():
            raise InputError(
                f"{self.path}", wanted="a training to go on with", came="none", remedy="Leave out --resume."
            )
        make_folder(self.path)
        with locked(self.path / LOCK):
            if start is Start.NEW and self._mark.exists():
                raise InputError(
                    f"{self.path}", wanted="a folder without a training", came="one that holds a training",
                    remedy="Go on with it by --resume, forget it by --fresh, or name another folder with --work.",
                )  # fmt: skip
            self.checkpoints.remove_leftovers()
            if start is Start.FRESH:
                self._clear()
            if start is not Start.RESUME:
                content = {"jghand_training": __version__, "stamp": dict(self._stamp)}
                with writing(self._mark) as temporary:
                    temporary.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
            yield

    @property
    def _mark(self) -> Path:
        return self.path / MARK

    def _refuse_foreign_files(self) -> None:
        try:
            names = {entry.name for entry in self.path.iterdir()} if self.path.exists() else set()
        except OSError as error:
            raise file_error(self.path, error) from error
        if names - {LOCK} and MARK not in names:
            raise InputError(
                f"{self.path}", wanted="a new or empty folder, or one of a training",
                came=f"one with {sorted(names - {LOCK})[0]}", remedy="Name another folder with --work.",
            )  # fmt: skip

    def _clear(self) -> None:
        """Removes what a training leaves and nothing else, except the record of the output, which stays its own."""
        # the mark first: should this break off, no half-cleared training can be gone on with
        for path in (self._mark, self.log, self.path / "preview.jghand"):
            path.unlink(missing_ok=True)
        self.checkpoints.clear()
        for picture in (self.path / "pictures").glob("step_*.png"):
            picture.unlink()
        for folder in (self.board, self.failures):
            shutil.rmtree(folder, ignore_errors=True)
