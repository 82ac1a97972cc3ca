"""Where jobs run: in processes of this machine, or as jobs of a SLURM cluster, both through the optional package
submitit (extra `farm`)."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from jghand_engine.errors import InputError, RetryError, install_extra
from jghand_engine.farm.signals import STOPS, unheard_by_programs
from jghand_engine.limits import (
    LOCAL_MINUTES_MAX,
    LOCAL_POLL_S,
    SIGNAL_BEFORE_S,
    SLURM_ANSWER_S,
    SLURM_MINUTES_MIN,
    SLURM_POLL_S,
    TIMEOUTS_MAX,
)


class Executor(Protocol):
    """at_once: how many jobs may be submitted and not ended, None for any number · poll_s: between two looks ·
    outlived: whether its jobs go on without this process, so that later ones watch them by their numbers"""

    at_once: int | None
    poll_s: float
    outlived: bool

    def submit(self, jobs: Mapping[str, Callable[[], Any]]) -> dict[str, str]:
        """Name -> number of the job that was made of it. RetryError when the scheduler refuses."""
        ...

    def alive(self, numbers: Sequence[str]) -> set[str]:
        """Those that wait or run. RetryError when the scheduler does not answer."""
        ...

    def stop(self) -> None:
        """Asks the jobs of this process to end, again and again; nothing where they go on without it."""
        ...


class LocalExecutor:
    """Processes of this machine, `at_once` at a time."""

    poll_s, outlived = LOCAL_POLL_S, False

    def __init__(self, logs: Path, at_once: int) -> None:
        self.at_once: int | None = at_once
        self._executor = _submitit().LocalExecutor(logs, max_num_timeout=TIMEOUTS_MAX)
        self._executor.update_parameters(timeout_min=LOCAL_MINUTES_MAX, signal_delay_s=SIGNAL_BEFORE_S)
        self._jobs: dict[str, Any] = {}

    def submit(self, jobs: Mapping[str, Callable[[], Any]]) -> dict[str, str]:
        """See Executor."""
        numbers = {}
        for name, job in jobs.items():
            # both reach every process of a terminal: these are told by `stop`
            with unheard_by_programs(signal.SIGINT, signal.SIGHUP):
                submitted = self._executor.submit(job)
            self._jobs[submitted.job_id] = submitted
            numbers[name] = submitted.job_id
        return numbers

    def alive(self, numbers: Sequence[str]) -> set[str]:
        """See Executor."""
        return {number for number in numbers if number in self._jobs and not self._jobs[number].done()}

    def stop(self) -> None:
        """See Executor."""
        for number in self.alive(list(self._jobs)):
            with contextlib.suppress(ProcessLookupError):
                os.kill(int(number), signal.SIGTERM)


@dataclass(frozen=True)
class SlurmOptions:
    """What a job asks of the cluster. partition: None for its default · minutes: of one start; a training that needs
    more is begun again · cpus, memory_gb: of one job · more: further options of sbatch, without their dashes"""

    partition: str | None = None
    minutes: int = 240
    cpus: int = 4
    memory_gb: float = 8.0
    more: Mapping[str, str] = field(default_factory=dict)

    def check(self) -> None:
        """InputError for what no job can ask."""
        if self.minutes < SLURM_MINUTES_MIN:
            raise InputError("--time-limit", wanted=f"{SLURM_MINUTES_MIN} minutes or more", came=str(self.minutes))
        for name, value in (("--cpus", self.cpus), ("--memory-gb", self.memory_gb)):
            if not value > 0:
                raise InputError(name, wanted="more than 0", came=f"{value:g}")


class SlurmExecutor:
    """One array of jobs. They go on when this process ends."""

    poll_s, outlived = SLURM_POLL_S, True

    def __init__(self, logs: Path, options: SlurmOptions, running: int) -> None:
        """running: how many of the jobs may run at once; 0 leaves it to the cluster"""
        self.at_once: int | None = None
        self._running = running
        options.check()
        if shutil.which("srun") is None or shutil.which("squeue") is None:
            raise InputError(
                "--executor slurm", wanted="the commands of a SLURM cluster", came="no srun or squeue on the PATH",
                remedy="Start it where jobs are submitted, or take --executor local.",
            )  # fmt: skip
        self._executor = _submitit().SlurmExecutor(logs, max_num_timeout=TIMEOUTS_MAX)
        self._executor.update_parameters(
            job_name="jghand", time=options.minutes, cpus_per_task=options.cpus, mem=f"{options.memory_gb:g}GB",
            signal_delay_s=SIGNAL_BEFORE_S, additional_parameters={"requeue": True, **options.more},
            **({"partition": options.partition} if options.partition else {}),
        )  # fmt: skip

    def submit(self, jobs: Mapping[str, Callable[[], Any]]) -> dict[str, str]:
        """See Executor."""
        # left to itself submitit lets 256 run at once
        self._executor.update_parameters(array_parallelism=self._running or len(jobs))
        try:
            with unheard_by_programs(*STOPS), self._executor.batch():
                submitted = {name: self._executor.submit(job) for name, job in jobs.items()}
            return {name: job.job_id for name, job in submitted.items()}
        # submitit's own are RuntimeErrors
        except (RuntimeError, OSError, subprocess.SubprocessError) as error:
            raise RetryError(
                "SLURM did not take the jobs",
                came=_last_line(str(error)),
                remedy="Look at the partition and the limits.",
            ) from error

    def alive(self, numbers: Sequence[str]) -> set[str]:
        """See Executor."""
        command = ["squeue", "--me", "--noheader", "--array", "--format=%i"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=SLURM_ANSWER_S)
        except (OSError, subprocess.SubprocessError) as error:
            said = error.stderr if isinstance(error, subprocess.CalledProcessError) else str(error)
            raise RetryError("the cluster does not answer (squeue)", came=_last_line(said)) from error
        return set(numbers) & set(done.stdout.split())

    def stop(self) -> None:
        """See Executor."""


def _submitit() -> Any:
    if sys.platform == "win32":
        raise InputError("jobs", wanted="Linux, whose processes and signals they need", came="Windows")
    try:
        import submitit
    except ImportError as error:
        raise InputError("jobs", wanted="the package submitit", came="none", remedy=install_extra("farm")) from error
    return submitit


def _last_line(text: str) -> str:
    lines = [line for line in text.strip().splitlines() if line.strip()]
    return lines[-1][:300] if lines else "no reason"
