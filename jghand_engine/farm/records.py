"""How far the trainings of a list are, as files in the folder that all machines share.

OUT/NAME.jghand             the avatar, at the end
OUT/NAME.training/          its checkpoints, log and previews
OUT/jobs/records/NAME.json  its record, written by the job that runs it
OUT/jobs/records/NAME.lock  held by that job, and by who writes the record of a training that no job is at
OUT/jobs/submitted.json     name -> job of the cluster, written by `jghand train-many`
OUT/jobs/lock               held while that submits jobs
OUT/jobs/logs/              what the jobs print, and submitit's own files
"""

from __future__ import annotations

import contextlib
import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

from jghand_engine.errors import InputError
from jghand_engine.files import file_error, make_folder, writing
from jghand_engine.lock import locked


class State(StrEnum):
    """waiting: no job has begun it · running · stopped: told to, or preempted; it goes on from its checkpoint ·
    lost: its job is gone and left no word · failed · finished"""

    WAITING = "waiting"
    RUNNING = "running"
    STOPPED = "stopped"
    LOST = "lost"
    FAILED = "failed"
    FINISHED = "finished"


@dataclass
class Record:
    """What the jobs of a training note: of one that was killed it stays at what that noted last.

    words: what was asked for · starts: how often a job began or went on with it · exit_code, told: of the last one
    that ended, and what it said · progress: a sentence · host: where it ran last"""

    words: list[str]
    state: State = State.WAITING
    starts: int = 0
    exit_code: int | None = None
    told: str = ""
    progress: str = ""
    host: str = ""

    def is_of(self, words: Sequence[str]) -> bool:
        """Whether it is of these words of `jghand train`. Where the pictures lie is not compared: machines may know
        their folder by different names."""
        return self.words[2:] == list(words[2:])


class FarmFolder:
    """The folder OUT of a list."""

    def __init__(self, path: Path) -> None:
        self.path, self.jobs = path, path / "jobs"
        self.logs, self._records = self.jobs / "logs", self.jobs / "records"
        self._submitted = self.jobs / "submitted.json"

    def make(self) -> None:
        """Makes the folders. Only their owner may write or look into that of the logs: submitit's files there are
        read back as Python objects, which can run anything."""
        make_folder(self._records)
        try:
            self.logs.mkdir(mode=0o700, exist_ok=True)
            self.logs.chmod(0o700)
        except OSError as error:
            raise file_error(self.logs, error) from error

    @contextlib.contextmanager
    def alone(self, most_s: float = 0.0) -> Iterator[None]:
        """While it lasts no other `jghand train-many` submits jobs of this folder; it waits so long for the end of
        another. RetryError when that works on."""
        until_s = time.monotonic() + most_s
        with locked(self.jobs / "lock", work="jghand train-many", waits=lambda _: time.monotonic() < until_s):
            yield

    def avatar(self, name: str) -> Path:
        return self.path / f"{name}.jghand"

    def work(self, name: str) -> Path:
        return self.path / f"{name}.training"

    def lock(self, name: str) -> Path:
        return self._records / f"{name}.lock"

    def is_done(self, name: str, record: Record, words: Sequence[str]) -> bool:
        """Whether the avatar is there that these words of `jghand train` ask for."""
        return record.state is State.FINISHED and record.is_of(words) and self.avatar(name).is_file()

    def record(self, name: str) -> Record | None:
        """None where no job has begun it. InputError for a file that is none."""
        path = self._records / f"{name}.json"
        content = _read(path)
        if content is None:
            return None
        if isinstance(content, dict) and content.keys() == {field.name for field in fields(Record)}:
            with contextlib.suppress(ValueError):
                return Record(**{**content, "state": State(content["state"])})
        raise InputError(f"{path}", wanted="the record of a training", came="something else", remedy="Remove it.")

    def write_record(self, name: str, record: Record) -> None:
        _write(self._records / f"{name}.json", asdict(record))

    def submitted(self) -> dict[str, str]:
        """Name of a training -> its job, as the cluster calls it."""
        content = _read(self._submitted)
        return {str(name): str(job) for name, job in content.items()} if isinstance(content, dict) else {}

    def add_submitted(self, jobs: dict[str, str]) -> None:
        """Notes jobs beside those of other lists."""
        _write(self._submitted, self.submitted() | jobs)


def _read(path: Path) -> Any:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return None
    except OSError as error:
        raise file_error(path, error) from error
    except ValueError as error:
        raise InputError(f"{path}", wanted="JSON", came=str(error)[:200], remedy="Remove it.") from error


def _write(path: Path, content: Any) -> None:
    with writing(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
