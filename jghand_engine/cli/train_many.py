"""`jghand train-many`: a list of trainings, on this machine or as jobs of a SLURM cluster."""

from __future__ import annotations

import contextlib
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from jghand_engine.cli.console import say, say_table, write_json
from jghand_engine.cli.failures import FAULT, STOPPED
from jghand_engine.cli.options import ReportOptions
from jghand_engine.cli.signals import polite_kill_is_ctrl_c
from jghand_engine.cli.train import Train
from jghand_engine.errors import InputError, MemoryLimitError, RetryError
from jghand_engine.limits import PROGRESS_MANY_S

if TYPE_CHECKING:
    from jghand_engine.farm.executors import Executor
    from jghand_engine.farm.records import FarmFolder, Record
    from jghand_engine.farm.runner import Runner
    from jghand_engine.farm.trainings import Training

STOPPING = {
    "local": "Stopping: the trainings write their checkpoints.",
    "slurm": "The jobs go on without this command; started again it watches them.",
}
DESCRIPTION = """Train a list of hands, one after the other here or many at once on a SLURM cluster.

The list is a TOML file (docs/SCALE.md): what `jghand train` is told, for all of them and for each.

    minutes = 60
    [[training]]
    folder = "captures/id3"

The same command again goes on: what is finished stays, what was stopped, killed or preempted goes on with its last
checkpoint, jobs that still wait or run are watched. Needs the extra farm.

Examples:
  jghand train-many captures.toml --out avatars
  jghand train-many captures.toml --out avatars --executor slurm --partition cpu --time-limit 240"""


@dataclass(frozen=True)
class ClusterOptions:
    """Jobs of SLURM"""

    partition: Annotated[str | None, tyro.conf.arg(metavar="NAME", help_behavior_hint="")] = None
    """Where they run. Left out: the cluster's default."""
    time_limit: Annotated[int, tyro.conf.arg(metavar="MINUTES")] = 240
    """Of one start. A training that needs more writes its checkpoint, is queued again and goes on."""
    cpus: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 4
    """Cores of a job."""
    memory_gb: Annotated[float, tyro.conf.arg(metavar="NUMBER")] = 8.0
    """Memory of a job."""
    sbatch: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME=VALUE", help_behavior_hint="")] = ()
    """Further options of sbatch, such as account=hands."""
    submit_only: bool = False
    """Do not wait for the jobs. The same command without it watches them."""


@dataclass(frozen=True)
class TrainMany:
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE.toml")]
    """Which trainings."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where NAME.jghand, its work folder NAME.training and the records and logs of the jobs are written; on a cluster
    a folder that all its machines see."""
    executor: Literal["local", "slurm"] = "local"
    """local: processes of this machine. slurm: jobs of the cluster that this machine submits to."""
    jobs: Annotated[int, tyro.conf.arg(metavar="NUMBER", help_behavior_hint="(default: 1, or all that SLURM lets)")] = 0
    """How many run at once."""
    cluster: ClusterOptions = field(default_factory=ClusterOptions)
    report: ReportOptions = field(default_factory=ReportOptions)

    def run(self) -> int:
        """0 when all trainings are finished; else the exit code of the worst that happened to one."""
        from jghand_engine.farm.records import FarmFolder
        from jghand_engine.farm.runner import Runner
        from jghand_engine.farm.trainings import read_trainings

        trainings = read_trainings(self.file)
        different: dict[tuple[str, ...], Training] = {}
        for training in trainings:
            # of a thousand that differ in their folder alone, one
            different.setdefault(training.words[2:], training)
        for training in different.values():
            self._check(training)
        if self.jobs < 0:
            raise InputError("--jobs", wanted="1 or more", came=str(self.jobs))
        folder = FarmFolder(self.out)
        executor = self._executor(folder)
        folder.make()
        return self._see_through(Runner(trainings, folder, executor, say), folder)

    def _see_through(self, runner: Runner, folder: FarmFolder) -> int:
        done = sum(map(runner.is_done, runner.records))
        say(f"Trainings: {len(runner.records)}, of which {done} are finished already.")
        telling, stopped = Telling(), False
        with polite_kill_is_ctrl_c():
            try:
                if self.cluster.submit_only:
                    runner.submit()
                else:
                    runner.run(telling)
            except BaseException as error:
                stopped = isinstance(error, KeyboardInterrupt)
                # the terminal may be gone
                with contextlib.suppress(OSError):
                    if runner.watched:
                        say(STOPPING[self.executor])
                # processes of this machine would go on unseen
                runner.stop(telling)
                if not stopped:
                    raise
        self._show(runner, folder)
        return STOPPED if stopped else max((_exit_code(runner, name) for name in runner.records), key=_SEVERITY.index)

    def _check(self, training: Training) -> None:
        """InputError for options that `jghand train` would refuse: said now, and not by a thousand jobs."""
        style = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone)
        try:
            asked = tyro.cli(Train, args=[*training.words[1:], "--out", "any.jghand"], config=style)
            asked.check()
        except SystemExit as error:
            raise InputError(
                f"{self.file}: {training.name}", wanted="options that jghand train takes", came="others, see above"
            ) from error
        except InputError as error:
            raise InputError(f"{self.file}: {training.name}: {error}") from error
        if self.executor == "local" and asked.device == "cuda":
            raise InputError(
                f"{self.file}: {training.name}: device", wanted="the CPU: local jobs see no GPU", came="cuda",
                remedy="Leave it out, or start jghand train for each.",
            )  # fmt: skip

    def _executor(self, folder: FarmFolder) -> Executor:
        from jghand_engine.farm.executors import LocalExecutor, SlurmExecutor, SlurmOptions

        cluster = self.cluster
        if self.executor == "local":
            if cluster != ClusterOptions():
                raise InputError("--executor local", wanted="no options of a cluster", came="some",
                                 remedy="Add --executor slurm, or leave them out.")  # fmt: skip
            return LocalExecutor(folder.logs.resolve(), self.jobs or 1)
        pairs = [text.partition("=") for text in cluster.sbatch]
        if not all(name and sign for name, sign, _ in pairs):
            raise InputError("--sbatch", wanted="NAME=VALUE, such as account=hands", came=" ".join(cluster.sbatch))
        more = {name: value for name, _, value in pairs}
        options = SlurmOptions(cluster.partition, cluster.time_limit, cluster.cpus, cluster.memory_gb, more)
        return SlurmExecutor(folder.logs.resolve(), options, self.jobs)

    def _show(self, runner: Runner, folder: FarmFolder) -> None:
        from jghand_engine.farm.records import State

        rows = [(name, one.state, str(one.starts), one.progress or "-") for name, one in runner.records.items()]
        say_table(f"{folder.path}", ("training", "state", "starts", "where it stands"), rows)
        for name, record in runner.records.items():
            if record.told and record.state in (State.FAILED, State.LOST):
                say(f"{name}: {record.told}")
                if "--fresh" in record.told or "--work" in record.told:
                    say(f"A list begins a training anew when {folder.work(name)} is moved away or removed.")
                if "--overwrite" in record.told:
                    say("In the list that is: overwrite = true")
            if runner.is_changed(name):
                say(f"{name}: changed since it was submitted; run the same command again.")
        if any(record.state in (State.STOPPED, State.LOST, State.FAILED) for record in runner.records.values()):
            say(f"What the jobs printed is in {folder.logs}. The same command goes on.")
        if self.report.json is not None:
            trainings = {name: asdict(record) for name, record in runner.records.items()}
            write_json(self.report.json, {"command": "train-many", "out": str(folder.path), "trainings": trainings})


class Telling:
    """Says when the state of a training changes, and now and then how far it is."""

    def __init__(self) -> None:
        self._said: dict[str, tuple[str, float]] = {}

    def __call__(self, name: str, record: Record) -> None:
        state, since_s = self._said.get(name, ("", 0.0))
        now_s = time.monotonic()
        if state != record.state or now_s - since_s > PROGRESS_MANY_S:
            self._said[name] = record.state, now_s
            say(f"{name}: {record.state}" + (f", {record.progress}" if record.progress else ""))


# from the best to the worst: done, waits or runs, try again, memory, bad input, a fault
_SEVERITY = (0, RetryError.exit_code, MemoryLimitError.exit_code, InputError.exit_code, FAULT)


def _exit_code(runner: Runner, name: str) -> int:
    from jghand_engine.farm.records import State

    record = runner.records[name]
    if record.state is State.FAILED:
        # killed by a signal, as where the system has no memory left
        return record.exit_code if record.exit_code in _SEVERITY else RetryError.exit_code
    lacks = record.state in (State.STOPPED, State.LOST) or (record.state is State.FINISHED and not runner.is_done(name))
    return RetryError.exit_code if lacks or runner.is_changed(name) else 0
