"""`jghand train-many`: a list of trainings, on this machine or as an array of jobs of a SLURM cluster.

Every training is a process `jghand train` that writes a checkpoint when its standard input ends, so that it stops
tidily however the process that began it ends; begun again it gets --resume.
"""

from __future__ import annotations

import contextlib
import json
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
import tomllib
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

import tyro

from jghand_engine.cli.console import say, say_table, write_figures
from jghand_engine.cli.failures import polite_kill_is_ctrl_c
from jghand_engine.cli.options import FiguresFile
from jghand_engine.cli.train import Train
from jghand_engine.errors import STOPPED, InputError, RetryError, package
from jghand_engine.files import make_folder, write_file

DESCRIPTION = """Train a list of hands, some at once here, or as an array of jobs of a SLURM cluster.

The list is a TOML file (docs/SCALE.md): options of `jghand train`, for all of them and for each. The same command again
resumes what was stopped, killed or preempted, and leaves what is finished.

Examples:
  jghand train-many captures.toml --out avatars --jobs 2
  jghand train-many captures.toml --out avatars --slurm partition=cpu time=240 mem=8GB"""

# an array of SLURM has at most so many jobs where nobody changed its MaxArraySize; longer lists are several
TRAININGS_MAX = 1000
# what a job asks of the cluster where --slurm says nothing else; minutes of one start
SLURM_DEFAULTS = {"time": "240", "cpus_per_task": "4", "mem": "8GB"}
# seconds before its time is up that a job is told; its training may take so long for its checkpoint
SIGNAL_BEFORE_S, CHECKPOINT_WAIT_S = 90, 75.0
# seconds that a preempted job waits for SLURM to take it back: one that ended by itself would not be begun again
REQUEUE_WAIT_S = 300.0
# how often a job may come to the end of its time: each time it goes on
TIMEOUTS_MAX = 1000
# options of `jghand train` that a list may not give
OF_THE_LIST = {"out", "work", "resume", "fresh", "json", "progress_json"}
PROGRAM = (sys.executable, "-m", "jghand_engine")
# seconds between two looks at the process of a training
POLL_S = 0.2


@dataclass(frozen=True)
class TrainMany:
    file: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FILE.toml")]
    """Which trainings."""
    out: Annotated[Path, tyro.conf.arg(metavar="FOLDER")]
    """Where NAME.jghand, its work folder NAME.training and NAME.log are written; on a cluster a folder that all its
    machines see."""
    jobs: Annotated[int, tyro.conf.arg(metavar="NUMBER")] = 1
    """How many run at once here."""
    slurm: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME=VALUE", help_behavior_hint="")] = None
    """Submit an array of jobs instead, with these options of sbatch beside time=240 (minutes of one start; a longer
    training is queued again and goes on), cpus_per_task=4 and mem=8GB. Needs the extra farm."""
    json: FiguresFile = None

    def run(self) -> int:
        """0 when all trainings are finished or submitted; else the exit code of the first that is not finished."""
        if self.jobs < 1:
            raise InputError("--jobs", wanted="1 or more", came=str(self.jobs))
        out = make_folder(self.out).resolve()
        jobs = [TrainingJob(name, words, out) for name, words in read_list(self.file).items()]
        waiting = [job for job in jobs if not job.is_finished]
        say(f"{len(jobs)} trainings, {len(jobs) - len(waiting)} of them finished already.")
        if self.slurm is not None:
            numbers = submit(waiting, self.slurm, out / "jobs") if waiting else []
            say(f"Submitted: {', '.join(numbers) or 'nothing'}. The same command later takes up what is left.")
            return 0
        codes = {job.name: 0 for job in jobs} | run_here(waiting, self.jobs)
        states = {0: "finished", STOPPED: "stopped"}
        rows = [(job.name, states.get(codes[job.name], "failed"), job.last_words) for job in jobs]
        say_table(str(self.out), ("training", "state", "last words"), rows)
        told = {name: {"state": state, "exit_code": codes[name], "text": text} for name, state, text in rows}
        write_figures(self.json, {"command": "train-many", "out": str(self.out), "trainings": told})
        return next((code for code in codes.values() if code), 0)


# ---- the list --------------------------------------------------------------------------------------------------------


def read_list(path: Path) -> dict[str, tuple[str, ...]]:
    """Name -> words of `jghand train` but for --out, of every training of a TOML file, in its order.

    InputError names the table that is wrong: what `jghand train` would refuse is refused before anything is begun.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}", wanted="a TOML file", came=str(error)) from error
    tables = content.pop("training", None)
    if not isinstance(tables, list) or not 1 <= len(tables) <= TRAININGS_MAX:
        raise InputError(f"{path}", wanted=f"1 to {TRAININGS_MAX} tables [[training]]", came="something else")
    named = [_training({**content, **table}, path.parent, f"{path}: training {n}") for n, table in enumerate(tables, 1)]
    for name, words in named:
        # a disk may know no capital letters
        if sum(name.casefold() == other.casefold() for other, _ in named) > 1:
            remedy = 'Give them a name of their own: name = "…".'
            raise InputError(f"{path}", wanted="a name for each", came=f"{name} more than once", remedy=remedy)
        _check(words, f"{path}: {name}")
    return dict(named)


def _training(table: dict[str, Any], base: Path, where: str) -> tuple[str, tuple[str, ...]]:
    """Name and words of one table."""
    folder = (base / str(table.pop("folder", ""))).resolve()
    if not folder.is_dir():
        raise InputError(f"{where}: folder", wanted="a folder of pictures", came=f"{folder}, which is none")
    name = str(table.pop("name", folder.name))
    if not re.fullmatch(r"[\w(+][\w .,()+-]*", name):
        raise InputError(f"{where}: name", wanted="letters, digits and signs of file names", came=repr(name))
    if own := sorted(table.keys() & OF_THE_LIST):
        raise InputError(f"{where}: {own[0]}", wanted="options of the training alone", came="what train-many decides")
    words = [str(folder)]
    # sorted: the same options are to be the same words
    for key, value in sorted(table.items()):
        if value is not False:
            values = [] if value is True else value if isinstance(value, list) else [value]
            words += ["--" + key.replace("_", "-"), *map(str, values)]
    return name, tuple(words)


def _check(words: tuple[str, ...], where: str) -> None:
    """InputError for options that `jghand train` would refuse: said now, and not by a thousand jobs."""
    style = (tyro.conf.OmitArgPrefixes, tyro.conf.FlagCreatePairsOff, tyro.conf.DisallowNone)
    try:
        tyro.cli(Train, args=[*words, "--out", "any.jghand"], config=style).check()
    except SystemExit as error:
        raise InputError(where, wanted="options that jghand train takes", came="others, see above") from error
    except InputError as error:
        raise InputError(f"{where}: {error.thing}", wanted=error.wanted, came=error.came) from error


# ---- one training ----------------------------------------------------------------------------------------------------


@dataclass
class TrainingJob:
    """A training as a process: what is run here, and what submitit runs, again after every preemption.

    name:    of the avatar's file
    words:   of `jghand train` but for --out
    out:     folder of the avatars, absolute
    program: what stands before the words of the command
    """

    name: str
    words: tuple[str, ...]
    out: Path
    program: tuple[str, ...] = field(default_factory=lambda: PROGRAM)
    _child: subprocess.Popen[bytes] | None = field(default=None, repr=False, compare=False)

    @property
    def _finished(self) -> Path:
        """Holds the words of the training that ended well."""
        return self.out / f"{self.name}.training" / "finished.json"

    @property
    def is_finished(self) -> bool:
        """Whether the avatar is there, trained with these options."""
        if not (self.out / f"{self.name}.jghand").is_file() or not self._finished.is_file():
            return False
        return json.loads(self._finished.read_text(encoding="utf-8")) == list(self.words)

    @property
    def last_words(self) -> str:
        log = self.out / f"{self.name}.log"
        lines = log.read_text(encoding="utf-8", errors="replace").splitlines() if log.is_file() else []
        for line in reversed(lines):
            with contextlib.suppress(ValueError, AttributeError):
                if text := json.loads(line).get("text"):
                    return str(text)
        return ""

    def train(self, stop: threading.Event) -> int:
        """Trains, from its checkpoint where there is one, until the end or until `stop` is set; the exit code."""
        begun = (self.out / f"{self.name}.training" / "training.json").is_file()
        command = [
            *self.program, "train", *self.words, "--out", str(self.out / f"{self.name}.jghand"), "--progress-json",
            *(["--resume"] if begun else []),
        ]  # fmt: skip
        with (self.out / f"{self.name}.log").open("ab") as log:
            # a session of its own: Ctrl-C in a terminal reaches this process alone, which stops the training once
            self._child = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, start_new_session=True,
                # the signal of preemption is meant for the job, which stops its training by closing its standard input
                preexec_fn=lambda: signal.signal(signal.SIGUSR2, signal.SIG_IGN),
            )  # fmt: skip
        try:
            while self._child.poll() is None and not stop.wait(POLL_S):
                pass
        finally:
            code = self._stop()
        if code == 0:
            write_file(self._finished, json.dumps(self.words))
        return code

    def _stop(self) -> int:
        """Asks for the checkpoint by closing standard input, and waits for the end; the exit code."""
        if (child := self._child) is None or child.stdin is None:
            return STOPPED
        with contextlib.suppress(OSError):
            child.stdin.close()
        try:
            return child.wait(CHECKPOINT_WAIT_S)
        except subprocess.TimeoutExpired:
            child.kill()
            return child.wait()

    def __call__(self) -> str:
        """What submitit runs; after a RuntimeError the scheduler calls the job failed."""
        code = self.train(threading.Event())
        if code == STOPPED:
            time.sleep(REQUEUE_WAIT_S)
        if code:
            raise RuntimeError(f"{self.name} ended with exit code {code}: {self.last_words}")
        return self.last_words

    def checkpoint(self) -> Any:
        """What submitit asks for when the job is preempted or its time is up: the same job, queued again."""
        from submitit.helpers import DelayedSubmission

        self._stop()
        return DelayedSubmission(replace(self, _child=None))


# ---- all of them -----------------------------------------------------------------------------------------------------


def run_here(jobs: list[TrainingJob], at_once: int) -> dict[str, int]:
    """Trains them, some at once; the exit code of each. One that fails does not stop the others; Ctrl-C stops all."""
    stop, codes = threading.Event(), {job.name: STOPPED for job in jobs}

    def run(job: TrainingJob) -> None:
        if not stop.is_set():
            say(f"{job.name}: begins")
            codes[job.name] = job.train(stop)
            say(f"{job.name}: {job.last_words}")

    with polite_kill_is_ctrl_c(), ThreadPoolExecutor(at_once) as pool:
        running = [pool.submit(run, job) for job in jobs]
        try:
            for one in running:
                one.result()
        except KeyboardInterrupt:
            say("Stopping: the trainings write their checkpoints.")
        finally:
            stop.set()
    return codes


def submit(jobs: list[TrainingJob], asked: tuple[str, ...], logs: Path) -> list[str]:
    """One array of jobs; their numbers. asked: NAME=VALUE, options of sbatch. RetryError when SLURM refuses."""
    if not all(re.fullmatch(r"\w+=.+", text) for text in asked):
        raise InputError("--slurm", wanted="NAME=VALUE, such as partition=cpu", came=" ".join(asked))
    if shutil.which("srun") is None:
        raise InputError("--slurm", wanted="the commands of a SLURM cluster", came="no srun on the PATH")
    submitit = package("submitit", "--slurm", "farm")
    options = SLURM_DEFAULTS | dict(text.split("=", 1) for text in asked)
    # submitit reads its own files there back as Python objects, which can run anything
    make_folder(logs).chmod(0o700)
    executor = submitit.SlurmExecutor(logs, max_num_timeout=TIMEOUTS_MAX)
    executor.update_parameters(
        job_name="jghand", time=int(options.pop("time")), signal_delay_s=SIGNAL_BEFORE_S, additional_parameters=options
    )
    try:
        return [job.job_id for job in executor.submit_array(jobs)]
    # submitit's own errors are RuntimeErrors
    except (RuntimeError, OSError, subprocess.SubprocessError) as error:
        came, remedy = str(error).strip().splitlines()[-1:], "Check the partition and the limits."
        raise RetryError("SLURM did not take the jobs", came="".join(came), remedy=remedy) from error
