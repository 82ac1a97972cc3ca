# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs: child processes of the engine's command line, with progress, pause and cancel. Does not use bpy.

A job is asked to stop by the end of its standard input, which is Ctrl-C to the engine on every system and also reaches
it when Blender dies: a training writes its checkpoint, from which it can go on. What does not listen is ended by force.
Jobs belong to the running Blender, not to the opened file. Nothing here blocks but `wait` and `close`, which have a
limit.
"""

from __future__ import annotations

import shutil
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Any

from ..core.panel_text import duration
from ..errors import BAD_INPUT, EXIT_KINDS, INTERRUPTED, JGHandFailure
from . import state as machine
from .process import Child, told_in

# a job that was asked to stop finishes a step and writes a checkpoint, or a picture; then it is asked again, then ended
JOB_STOP_S = 30.0
# after its end: what it printed last may still be on its way
JOB_LAST_WORDS_S = 1.0
# the end of Blender waits so long for all jobs together; what needs longer ends by itself
JOB_END_S = 2.0
# how often jobs are looked after
JOB_LOOK_S = 0.25

# what every job gets; see jghand_engine/cli/progress_json.py
PROGRESS_OPTION = "--progress-json"
# letters of a job's text that are kept
_TEXT_MAX = 300


# ---- what is known of a job ------------------------------------------------------------------------------------------


class Phase(Enum):
    RUNNING = "running"
    CANCELLING = "canceling"
    DONE = "done"
    CANCELLED = "canceled"
    FAILED = "failed"

    @property
    def is_over(self) -> bool:
        return self in (Phase.DONE, Phase.CANCELLED, Phase.FAILED)


@dataclass(frozen=True)
class JobState:
    phase: Phase = Phase.RUNNING
    # what it does now
    text: str = "Starting"
    # of the present step; total: 0 while unknown
    done: float = 0.0
    total: float = 0.0
    # seconds left, None while unknown
    eta_s: float | None = None
    # why it failed
    failure: JGHandFailure | None = None

    @property
    def fraction(self) -> float | None:
        """0..1, None while unknown."""
        return min(max(self.done / self.total, 0.0), 1.0) if self.total > 0 else None

    def sentence(self) -> str:
        """One line for a panel: the step, the count, and the time that is left."""
        if self.phase is Phase.FAILED and self.failure is not None:
            return self.failure.advice.sentence
        if self.phase is not Phase.RUNNING:
            return self.phase.value.capitalize()
        text = self.text
        # the text of a training counts its steps itself
        if self.total > 0 and " of " not in self.text:
            text = f"{text} {round(self.done)} of {round(self.total)}"
        if self.eta_s is not None and self.done < self.total and " left" not in self.text:
            text = f"{text} · {duration(self.eta_s)} left"
        return text

    def after(self, content: Mapping[str, Any]) -> JobState:
        """After a line of progress. What makes no sense in it is left out."""
        numbers = {name: _number(content.get(name)) for name in ("done", "total", "eta_s")}
        return replace(
            self,
            text=str(content.get("text", ""))[:_TEXT_MAX],
            done=numbers["done"] or 0.0,
            total=numbers["total"] or 0.0,
            eta_s=numbers["eta_s"],
        )

    def failed(self, failure: JGHandFailure) -> JobState:
        return replace(self, phase=Phase.FAILED, eta_s=None, failure=failure)


def failure_of(exit_code: int, error: Mapping[str, Any] | None, log: str) -> JGHandFailure:
    """Why a process ended: what it said itself, else what its exit code tells."""
    if error is not None:
        return JGHandFailure(str(error.get("kind")), str(error.get("text", "")))
    last = "\n".join(log.splitlines()[-machine.DETAIL_LINES :])
    if "No module named" in log and "jghand_engine" in log:
        return JGHandFailure("no_engine", last)
    if exit_code == BAD_INPUT:
        # a mistake in the arguments: an engine that does not know what this extension asks for
        return JGHandFailure("protocol", last)
    kind = EXIT_KINDS.get(exit_code, "crashed")
    return JGHandFailure(kind, f"exit code {exit_code}\n{last}".strip() if kind == "crashed" else last)


def _number(value: Any) -> float | None:
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


# ---- jobs ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class JobSpec:
    # for people
    title: str
    # program and arguments
    command: tuple[str, ...]
    # of a training: where what it needs to go on lies
    folder: Path = Path()
    # commands that follow, one after the other, each after the one before has succeeded
    more: tuple[tuple[str, ...], ...] = ()
    # called once, on the thread that ticks, when it is done; what it raises makes the job a failed one
    on_done: Callable[[], None] | None = None
    # folders that only the job needs: they go when it is over, however it ended
    scratch: tuple[Path, ...] = ()


class Job:
    def __init__(self, spec: JobSpec) -> None:
        """Starts it. A program that is not there makes a failed job, not an exception."""
        self.spec = spec
        self.state = JobState()
        self._waiting = deque(spec.more)
        self._start(spec.command)

    @property
    def log(self) -> str:
        """The last lines that it printed, but for progress."""
        return "\n".join(self._output)

    @property
    def is_over(self) -> bool:
        """Whether its process has ended and was noticed to."""
        return self.state.phase.is_over

    @property
    def silent_s(self) -> float:
        return time.monotonic() - self._heard_s

    def tick(self) -> bool:
        """Looks what happened since the last time; True when the state is another one."""
        before = self.state
        if self.is_over:
            return False
        self._take_news()
        process = self._process
        code = process.popen.poll() if process is not None else None
        if process is not None and code is None:
            waited_s = 0.0 if self._asked_s is None else time.monotonic() - self._asked_s
            if waited_s > JOB_STOP_S:  # by force what does not answer a request to stop
                process.end_tree(at_once=waited_s > JOB_STOP_S + machine.TERMINATE_S)
        elif code is not None and self._said_all():
            self._end(code)
        return self.state != before

    def cancel(self) -> None:
        """Asks it to stop; what it has written stays."""
        if self.is_over:
            return
        self.state = replace(self.state, phase=Phase.CANCELLING)
        if self._asked_s is None:
            self._asked_s = time.monotonic()
            self.close_input()

    def wait(self, timeout_s: float) -> bool:
        """Blocks until it is over, at most so long; True when it is over."""
        until = time.monotonic() + timeout_s
        while not self.is_over and time.monotonic() < until:
            self.tick()
            if self._process is not None and not self.is_over and self._process.ends_within(machine.POLL_S):
                self._process.said_all(machine.POLL_S)
        return self.is_over

    def kill(self) -> None:
        """Ends it at once, with the processes that it started. What hangs in the system is not waited for: it ends when
        the system lets go of it."""
        process = self._process
        if process is not None and process.popen.poll() is None:
            process.end_tree(at_once=True)
            if not process.ends_within(machine.KILL_S):
                return
        self.wait(2 * JOB_LAST_WORDS_S)

    def close_input(self) -> None:
        """Asks it to stop, whether it is looked at any more or not: a training writes its checkpoint, and ends."""
        if self._process is not None:
            self._process.close_stdin()

    # ---- the process -------------------------------------------------------------------------------------------------

    def _start(self, command: tuple[str, ...]) -> None:
        self._output: deque[str] = deque(maxlen=machine.LOG_LINES)
        self._progress: Mapping[str, Any] | None = None
        self._error: Mapping[str, Any] | None = None
        self._heard_s = time.monotonic()
        self._asked_s: float | None = None
        self._ending_s: float | None = None
        self._process: Child | None = None
        try:
            self._process = Child((*command, PROGRESS_OPTION), self._hear, lambda: None)
        except JGHandFailure as failure:
            self.state = self.state.failed(failure)
            self._over()

    def _hear(self, line: str, _is_output: bool) -> None:
        """However much comes, only the newest is kept."""
        self._heard_s = time.monotonic()
        content = told_in(line)
        match content.get("jghand"):
            case "error":
                self._error = content
            case "progress" | "training":
                self._progress = content
            case other if line and not isinstance(other, str):
                self._output.append(line[: machine.LOG_LINE_MAX])

    def _take_news(self) -> None:
        progress, self._progress = self._progress, None
        if progress is not None:
            self.state = self.state.after(progress)

    def _said_all(self) -> bool:
        """Whether what an ended process printed last is here, or was waited for long enough; never here."""
        if self._ending_s is None:
            self._ending_s = time.monotonic()
        waited_s = time.monotonic() - self._ending_s
        return waited_s > JOB_LAST_WORDS_S or (self._process is not None and self._process.said_all())

    def _end(self, code: int) -> None:
        self._take_news()
        self.close_input()
        canceled = self.state.phase is Phase.CANCELLING
        if code == 0 and self._waiting and not canceled:
            self.state = JobState(text=self.spec.title)
            self._start(self._waiting.popleft())
            return
        if code == 0 and not self._waiting:
            self.state = replace(self.state, phase=Phase.DONE, eta_s=None)
            if self.spec.on_done is not None:
                self._call(self.spec.on_done)
        elif code == INTERRUPTED or (canceled and self._error is None):
            self.state = replace(self.state, phase=Phase.CANCELLED, eta_s=None)
        else:
            self.state = self.state.failed(failure_of(code, self._error, self.log))
        self._over()

    def _over(self) -> None:
        for folder in self.spec.scratch:
            shutil.rmtree(folder, ignore_errors=True)

    def _call(self, work: Callable[[], None]) -> None:
        """What others have to do at the end. Whatever goes wrong there makes this a failed job, with its trace in the
        log, and is no end of the other jobs."""
        try:
            work()
        except JGHandFailure as failure:
            self.state = self.state.failed(failure)
        except Exception as error:
            self._output.extend(traceback.format_exc().splitlines())
            self.state = self.state.failed(JGHandFailure("internal", f"{type(error).__name__}: {error}"))


class JobTable:
    """The jobs of this Blender, the newest of each key. Kept beside the opened file, so that opening another one ends
    nothing."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}

    def start(self, key: str, spec: JobSpec) -> Job:
        """Starts a job. JGHandFailure (job_running) while the one of that key runs."""
        self.refuse_second(key)
        self._jobs[key] = Job(spec)
        return self._jobs[key]

    def get(self, key: str) -> Job | None:
        return self._jobs.get(key)

    def runs(self, key: str) -> bool:
        return key in self._jobs and not self._jobs[key].is_over

    def refuse_second(self, key: str) -> None:
        """JGHandFailure (job_running) while a job of that key runs."""
        if self.runs(key):
            raise JGHandFailure("job_running", self._jobs[key].spec.title)

    @property
    def running(self) -> list[Job]:
        """Those whose process may still live."""
        return [job for job in self._jobs.values() if not job.is_over]

    def tick(self) -> bool:
        """Looks after all of them; True when one changed, and a panel is to be drawn anew."""
        changed = [job.tick() for job in self.running]  # every one of them, also after one that changed
        return any(changed)

    def close(self) -> None:
        """The end of Blender or of the extension: all are asked to stop and a moment is given to them. Those that need
        longer, as a training for its checkpoint, end by themselves."""
        running = self.running
        for job in running:
            job.close_input()
        until = time.monotonic() + JOB_END_S
        for job in running:
            job.wait(max(until - time.monotonic(), 0.0))
        self._jobs.clear()
