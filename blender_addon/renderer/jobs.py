# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs: child processes of the engine's command line, with progress, pause and cancel. Does not use bpy.

A job is asked to stop by the end of its standard input, which is Ctrl-C to the engine on every system and also reaches
it when Blender dies: a training writes its checkpoint. What does not listen is ended by force. Jobs belong to the
running Blender, not to the opened file. Nothing here blocks but `wait` and `close`, which have a limit.
"""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any

from ..core import limits
from ..errors import INTERRUPTED, JGHandFailure
from . import job_state
from .job_state import JobState, Phase
from .process import cleaned_environment
from .programs import HIDDEN, end_tree

# what every job gets; see jghand_engine/cli/machine.py
PROGRESS_OPTION = "--progress-json"


@dataclass(frozen=True)
class JobSpec:
    """What is to be done. kind: what sort of job · title: for people · command: program and arguments · folder: where
    its results and what it needs to go on lie · resume: the command that goes on after a pause, empty where there is
    none · on_done: called once, on the thread that ticks, when it is done; what it raises makes the job a failed one ·
    more: commands that follow, one after the other, each after the one before has succeeded · on_over: called once,
    when it is over however it ended and will not go on; takes away what only the job needed.
    """

    kind: str
    title: str
    command: tuple[str, ...]
    folder: Path
    resume: tuple[str, ...] = ()
    on_done: Callable[[], None] | None = None
    more: tuple[tuple[str, ...], ...] = ()
    on_over: Callable[[], None] | None = None


class Job:
    """One running or finished job."""

    def __init__(self, spec: JobSpec, *, environment: Mapping[str, str] = os.environ) -> None:
        """Starts it. A program that is not there makes a failed job, not an exception."""
        self.spec = spec
        self.state = JobState()
        self._environment = environment
        self._waiting = deque(spec.more)
        self._put_away = False
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
        """Seconds since it last said anything."""
        return time.monotonic() - self._heard_s

    def tick(self) -> bool:
        """Looks what happened since the last time; True when the state is another one."""
        before = self.state
        if self.is_over:
            return False
        self._take_news()
        process = self._process
        code = process.poll() if process is not None else None
        if process is not None and code is None:
            self._insist()
        elif code is not None and self._said_all():
            self._end(code)
        return self.state != before

    def pause(self) -> None:
        """Asks a job that can go on later to stop."""
        if self.spec.resume:
            self._ask(pause=True)

    def cancel(self) -> None:
        """Asks it to stop. A paused job is canceled at once; what it has written stays."""
        if self.state.phase is Phase.PAUSED:
            self.state = job_state.JobState(Phase.CANCELLED, self.state.text)
            self.put_away()
            return
        self._ask(pause=False)

    def go_on(self) -> None:
        """Starts a paused job, or one that failed, again where it stands."""
        if self.is_over and self._can_go_on():
            self.state = JobState(notes=self.state.notes)
            self._start(self.spec.resume)

    def wait(self, timeout_s: float, *, canceled: Callable[[], bool] = lambda: False) -> bool:
        """Blocks until it is over, at most so long, asking `canceled` all the while; True when it is over."""
        until = time.monotonic() + timeout_s
        while not self.is_over and time.monotonic() < until:
            self.tick()
            if self.state.phase is Phase.RUNNING and canceled():
                self.cancel()
            if self._process is not None and not self.is_over:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    self._process.wait(limits.POLL_S)
                for reader in self._readers if self._ending_s is not None else ():
                    reader.join(limits.POLL_S)
        return self.is_over

    def kill(self) -> None:
        """Ends it at once, with the processes that it started. What hangs in the system is not waited for: it ends when
        the system lets go of it."""
        process = self._process
        if process is not None and process.poll() is None:
            end_tree(process, at_once=True)
            try:
                process.wait(limits.KILL_S)
            except subprocess.TimeoutExpired:
                return
        self.wait(2 * limits.JOB_LAST_WORDS_S)

    def put_away(self) -> None:
        """Nobody wants it to go on any more: what only it needed is taken away, once."""
        if self.is_over and not self._put_away:
            self._put_away = True
            if self.spec.on_over is not None:
                self._call(self.spec.on_over)

    def let_go(self) -> None:
        """The end of Blender: the job is asked to stop and not looked at any more. It ends by itself, a training with
        its checkpoint."""
        self._close_input()

    # ---- the process -------------------------------------------------------------------------------------------------

    def _start(self, command: tuple[str, ...]) -> None:
        self._output: deque[str] = deque(maxlen=limits.LOG_LINES)
        self._notes: deque[Mapping[str, Any]] = deque(maxlen=limits.JOB_NOTES)
        self._progress: Mapping[str, Any] | None = None
        self._error: Mapping[str, Any] | None = None
        self._heard_s = time.monotonic()
        self._asked_s: float | None = None
        self._ending_s: float | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._readers: list[threading.Thread] = []
        try:
            process = subprocess.Popen(
                [*command, PROGRESS_OPTION],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=cleaned_environment(self._environment),
                creationflags=HIDDEN,
                # a Ctrl-C in Blender's terminal is Blender's, and all that a job starts ends with it
                start_new_session=os.name != "nt",
            )
        except OSError as error:
            failure = JGHandFailure("no_interpreter", f"{command[0]}: {error.strerror or error}")
            self.state = job_state.failed(self.state, failure)
            self._put_away_unless_it_can_go_on()
            return
        self._process = process
        for pipe in (process.stdout, process.stderr):
            reader = threading.Thread(target=self._read, args=(pipe,), daemon=True, name="jghand job")
            reader.start()
            self._readers.append(reader)

    def _read(self, pipe: IO[bytes]) -> None:
        """Keeps a pipe from filling up. However much comes, only the newest is kept."""
        with pipe:
            for raw in iter(lambda: pipe.readline(limits.JOB_LINE_MAX), b""):
                line = raw.decode("utf-8", "replace").rstrip()
                self._heard_s = time.monotonic()
                content = job_state.parse_line(line)
                if content is None:
                    if line:
                        self._output.append(line[: limits.LOG_LINE_MAX])
                elif content["jghand"] == "error":
                    self._error = content
                elif content["jghand"] == "note":
                    self._notes.append(content)
                else:
                    self._progress = content

    def _take_news(self) -> None:
        progress, self._progress = self._progress, None
        if progress is not None:
            self.state = job_state.heard(self.state, progress)
        while self._notes:
            self.state = job_state.heard(self.state, self._notes.popleft())

    def _said_all(self) -> bool:
        """Whether what an ended process printed last is here. A process that it left behind may hold its pipes open:
        that is not waited for longer than a moment, and never here."""
        if self._ending_s is None:
            self._ending_s = time.monotonic()
        waited_s = time.monotonic() - self._ending_s
        return waited_s > limits.JOB_LAST_WORDS_S or not any(reader.is_alive() for reader in self._readers)

    def _can_go_on(self) -> bool:
        return bool(self.spec.resume) and self.state.phase is not Phase.DONE

    def _put_away_unless_it_can_go_on(self) -> None:
        if self.state.phase is Phase.CANCELLED or not self._can_go_on():
            self.put_away()

    def _end(self, code: int) -> None:
        self._take_news()
        self._close_input()
        can_pause = bool(self.spec.resume)
        if code == 0 and self._waiting and self.state.phase is Phase.CANCELLING:
            code = INTERRUPTED  # what was to follow does not
        self.state = job_state.ended(self.state, code, self._error, self.log, can_pause=can_pause)
        if self.state.phase is Phase.DONE and self._waiting:
            self.state = JobState(text=self.spec.title, notes=self.state.notes)
            self._start(self._waiting.popleft())
        elif self.state.phase is Phase.DONE and self.spec.on_done is not None:
            self._call(self.spec.on_done)
        if self.is_over:
            self._put_away_unless_it_can_go_on()

    def _call(self, work: Callable[[], None]) -> None:
        """What others have to do at the end. Whatever goes wrong there makes this a failed job, with its trace in the
        log, and is no end of the other jobs."""
        try:
            work()
        except JGHandFailure as failure:
            self.state = job_state.failed(self.state, failure)
        except Exception as error:
            self._output.extend(traceback.format_exc().splitlines())
            failure = JGHandFailure("internal", f"{type(error).__name__}: {error}", log=self.log)
            self.state = job_state.failed(self.state, failure)

    def _ask(self, *, pause: bool) -> None:
        self.state = job_state.asked_to_stop(self.state, pause=pause)
        if self._asked_s is None and not self.is_over:
            self._asked_s = time.monotonic()
            self._close_input()

    def _insist(self) -> None:
        """Ends by force what does not answer a request to stop."""
        if self._asked_s is None or self._process is None:
            return
        waited_s = time.monotonic() - self._asked_s
        if waited_s > limits.JOB_STOP_S + limits.TERMINATE_S:
            end_tree(self._process, at_once=True)
        elif waited_s > limits.JOB_STOP_S:
            end_tree(self._process, at_once=False)

    def _close_input(self) -> None:
        if self._process is not None and self._process.stdin is not None:
            with contextlib.suppress(OSError):
                self._process.stdin.close()


class JobTable:
    """The jobs of this Blender, the newest of each key. Kept beside the opened file, so that opening another one ends
    nothing."""

    def __init__(self) -> None:
        self._jobs: dict[str, Job] = {}

    def start(self, key: str, spec: JobSpec) -> Job:
        """Starts a job. JGHandFailure (job_running) while the one of that key runs."""
        old = self._jobs.get(key)
        if old is not None and not old.is_over:
            raise JGHandFailure("job_running", old.spec.title)
        if old is not None:
            old.put_away()
        self._jobs[key] = Job(spec)
        return self._jobs[key]

    def get(self, key: str) -> Job | None:
        """The newest job of a key."""
        return self._jobs.get(key)

    def forget(self, key: str) -> None:
        """Takes a job that is over off the list."""
        job = self._jobs.get(key)
        if job is not None and job.is_over:
            job.put_away()
            del self._jobs[key]

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
            job.let_go()
        until = time.monotonic() + limits.JOB_END_S
        for job in running:
            job.wait(max(until - time.monotonic(), 0.0))
        for job in self._jobs.values():
            job.put_away()
        self._jobs.clear()
