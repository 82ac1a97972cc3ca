"""How far the trainings of a list are, as files in the folder that all machines share.

OUT/NAME.jghand           the avatar, at the end
OUT/NAME.training/        its checkpoints, log and previews
OUT/jobs/NAME.json        its record, written by the job that runs it
OUT/jobs/submitted.json   name -> job of the scheduler, written by `jghand train-many`
OUT/jobs/logs/            what the jobs print, and submitit's own files
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from enum import StrEnum
from pathlib import Path
from typing import Any

from jghand_engine.errors import InputError
from jghand_engine.files import file_error, make_folder, writing


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
    """words: what was asked for · starts: how often a job began or went on with it · exit_code, told: of the last one
    that ended, and what it said · progress: a sentence · host: where it ran last"""

    words: list[str]
    state: State = State.WAITING
    starts: int = 0
    exit_code: int | None = None
    told: str = ""
    progress: str = ""
    host: str = ""


class FarmFolder:
    """The folder OUT of a list."""

    def __init__(self, path: Path) -> None:
        self.path, self.jobs = path, path / "jobs"
        self.logs, self._submitted = self.jobs / "logs", self.jobs / "submitted.json"

    def make(self) -> None:
        """Makes the folders. Only their owner may write or look into that of the logs: submitit's files there are
        read back as Python objects, which can run anything."""
        make_folder(self.jobs)
        try:
            self.logs.mkdir(mode=0o700, exist_ok=True)
            self.logs.chmod(0o700)
        except OSError as error:
            raise file_error(self.logs, error) from error

    def avatar(self, name: str) -> Path:
        return self.path / f"{name}.jghand"

    def work(self, name: str) -> Path:
        return self.path / f"{name}.training"

    def record(self, name: str) -> Record | None:
        """None where no job has begun it. InputError for a file that is none."""
        content = _read(self._record(name))
        if content is None:
            return None
        if not isinstance(content, dict) or content.keys() != {field.name for field in fields(Record)}:
            raise InputError(f"{self._record(name)}", wanted="the record of a training", came="something else")
        return Record(**{**content, "state": State(content["state"])})

    def write_record(self, name: str, record: Record) -> None:
        _write(self._record(name), asdict(record))

    def submitted(self) -> dict[str, str]:
        """Name of a training -> its job, as the scheduler calls it."""
        content = _read(self._submitted)
        return {str(name): str(job) for name, job in content.items()} if isinstance(content, dict) else {}

    def write_submitted(self, jobs: dict[str, str]) -> None:
        _write(self._submitted, jobs)

    def _record(self, name: str) -> Path:
        return self.jobs / f"{name}.json"


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
