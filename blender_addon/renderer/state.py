# SPDX-License-Identifier: GPL-3.0-or-later
"""What becomes of the engine's process: states, events, and the one function that decides. Source: BLENDER 3.4 and 4.

`transition(state, event) -> (state, effects)` is pure: no clock (the time is in the event), no process, no lock.
Whoever calls it carries the effects out in order. Events of a process carry the number of its run, so that the end of
an earlier one, heard late, is not taken for the end of the present one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from ..core import limits

# after these a new start may help; after the others somebody must mend something first
PASSING = frozenset({"crashed", "killed", "hung", "out_of_memory", "broken_stream", "start_timeout"})


# ---- states ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class State:
    """run: number of the last start; restarts: starts after a failure since the user last asked for one; since_s: when
    the state began, on the clock of the events."""

    run: int = 0
    restarts: int = 0
    since_s: float = 0.0


@dataclass(frozen=True)
class Stopped(State):
    """by_user: it was stopped on purpose, so that a picture alone does not start it again."""

    by_user: bool = False


@dataclass(frozen=True)
class Starting(State):
    """The process was started and has not greeted yet."""


@dataclass(frozen=True)
class Ready(State):
    """silent_s: time without a sign of life during which somebody listened; looked_s: when somebody listened last."""

    silent_s: float = 0.0
    looked_s: float = 0.0

    @property
    def slow(self) -> bool:
        """Whether the engine should have said something."""
        return self.silent_s > limits.SLOW_S


@dataclass(frozen=True)
class Stopping(State):
    """start_again: it is being restarted; pushes: how often it was asked more strongly than by the end of its stdin;
    patience_s: as of StopAsked."""

    start_again: bool = False
    pushes: int = 0
    patience_s: float | None = None

    def next_push(self) -> tuple[float, Terminate | Kill] | None:
        """When, counted from the beginning of the stop, and how it is asked more strongly; None when it was already."""
        usual = ((limits.STOP_S, Terminate()), (limits.STOP_S + limits.TERMINATE_S, Kill()))
        pushes = usual if self.patience_s is None else ((self.patience_s, Kill()),)
        return pushes[self.pushes] if self.pushes < len(pushes) else None


@dataclass(frozen=True)
class Failed(State):
    """kind: a key of messages.ADVICE; detail: what happened, without the engine's own words."""

    kind: str = "crashed"
    detail: str = ""


# ---- events ----------------------------------------------------------------------------------------------------------


class Asker(Enum):
    """Who wants an engine. PICTURE: the viewport. WORK: what somebody waits for (a render). USER: a button."""

    PICTURE = "picture"
    WORK = "work"
    USER = "user"


@dataclass(frozen=True)
class Event:
    """now_s: when it happened."""

    now_s: float


@dataclass(frozen=True)
class StartAsked(Event):
    """Somebody wants an engine."""

    asker: Asker = Asker.USER


@dataclass(frozen=True)
class StopAsked(Event):
    """The user, or the end of the extension. patience_s: somebody waits for the end, no longer than that; None: nobody
    does, and the engine gets the usual time."""

    patience_s: float | None = None


@dataclass(frozen=True)
class RestartAsked(Event):
    """The user wants a new process whatever there is."""


@dataclass(frozen=True)
class Tick(Event):
    """Time passed; whatever had come from the engine was heard before."""


@dataclass(frozen=True)
class OfRun(Event):
    """Something about the process of that run."""

    run: int


@dataclass(frozen=True)
class Greeted(OfRun):
    """The engine said who it is, and is ours."""


@dataclass(frozen=True)
class Heard(OfRun):
    """A sign of life."""


@dataclass(frozen=True)
class Broke(OfRun):
    """It cannot be used any more, though its process may run: it could not start, is another program, makes no sense,
    or a request that was given up is still not finished."""

    kind: str = "broken_stream"
    detail: str = ""


@dataclass(frozen=True)
class Exited(OfRun):
    """The process is gone."""

    kind: str = "crashed"
    detail: str = ""


# ---- effects ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Spawn:
    """Start a process; its events carry this number."""

    run: int


@dataclass(frozen=True)
class CloseStdin:
    """Ask the process to end, which is what the end of its stdin means."""


@dataclass(frozen=True)
class Terminate:
    """Ask the process to end, as the system does it."""


@dataclass(frozen=True)
class Kill:
    """End the process and forget the connection."""


@dataclass(frozen=True)
class Release:
    """Answer everybody who waits with this failure."""

    kind: str
    detail: str = ""


Effect = Spawn | CloseStdin | Terminate | Kill | Release
Step = tuple[State, tuple[Effect, ...]]


# ---- decisions -------------------------------------------------------------------------------------------------------


def transition(state: State, event: Event) -> Step:
    """The next state and what is to be done. Every pair is defined; what does not matter changes nothing."""
    if isinstance(event, OfRun) and event.run != state.run:
        return state, ()
    match state:
        case Stopped():
            return _stopped(state, event)
        case Starting():
            return _starting(state, event)
        case Ready():
            return _ready(state, event)
        case Stopping():
            return _stopping(state, event)
        case Failed():
            return _failed(state, event)
    raise TypeError(f"{state!r} is no state")


def may_start(state: State, asker: Asker, now_s: float) -> bool:
    """Whether somebody's wish for an engine leads to one: it is there, on its way, or may be started now."""
    match state:
        case Stopped():
            return asker is not Asker.PICTURE or not state.by_user
        case Failed():
            if asker is Asker.USER:
                return True
            waited = now_s - state.since_s >= limits.RESTART_S
            return waited and state.kind in PASSING and state.restarts < limits.RESTARTS_MAX
        case Stopping():
            return state.start_again or asker is not Asker.PICTURE
    return True


def _stopped(state: Stopped, event: Event) -> Step:
    match event:
        case StartAsked():
            if may_start(state, event.asker, event.now_s):
                return _start(state, event, restarts=state.restarts)
            return state, (Release("stopped"),)
        case RestartAsked():
            return _start(state, event, restarts=0)
        case StopAsked():
            return replace(state, by_user=True), ()
    return state, ()


def _starting(state: Starting, event: Event) -> Step:
    match event:
        case Greeted():
            now_s = event.now_s
            return Ready(state.run, state.restarts, since_s=now_s, looked_s=now_s), ()
        case Exited():
            return _fail(state, event, event.kind, event.detail)
        case Broke():
            return _fail(state, event, event.kind, event.detail, Kill())
        case Tick() if event.now_s - state.since_s > limits.HANDSHAKE_S:
            return _fail(state, event, "start_timeout", "", Kill())
        case StopAsked():
            return _stop(state, event, start_again=False)
        case RestartAsked():
            return _stop(state, event, start_again=True)
    return state, ()


def _ready(state: Ready, event: Event) -> Step:
    match event:
        case Heard():
            return replace(state, silent_s=0.0, looked_s=event.now_s), ()
        case Tick():
            # a computer that slept, or a thread that got no turn, has not listened
            listened_s = min(max(event.now_s - state.looked_s, 0.0), 2 * limits.LOOK_S)
            silent_s = state.silent_s + listened_s
            if silent_s > limits.SILENCE_S:
                return _fail(state, event, "hung", "no sign of life", Kill())
            return replace(state, silent_s=silent_s, looked_s=event.now_s), ()
        case Exited():
            return _fail(state, event, event.kind, event.detail)
        case Broke():
            return _fail(state, event, event.kind, event.detail, Kill())
        case StopAsked():
            return _stop(state, event, start_again=False)
        case RestartAsked():
            return _stop(state, event, start_again=True)
    return state, ()


def _stopping(state: Stopping, event: Event) -> Step:
    match event:
        case Exited() if state.start_again:
            return _start(state, event, restarts=0)
        case Exited():
            return Stopped(state.run, state.restarts, event.now_s, by_user=True), ()
        case Tick():
            push = state.next_push()
            if push is not None and event.now_s - state.since_s > push[0]:
                return replace(state, pushes=state.pushes + 1), (push[1],)
        case RestartAsked():
            return replace(state, start_again=True), ()
        case StartAsked() if may_start(state, event.asker, event.now_s):
            return replace(state, start_again=True), ()
        case StartAsked():
            return state, (Release("stopped"),)
        case StopAsked(patience_s=None):
            return replace(state, start_again=False), (Release("stopped"),)
        case StopAsked():
            now_s, patience_s = event.now_s, event.patience_s
            return Stopping(state.run, state.restarts, now_s, patience_s=patience_s), (Release("stopped"),)
    return state, ()


def _failed(state: Failed, event: Event) -> Step:
    match event:
        case StartAsked():
            if may_start(state, event.asker, event.now_s):
                return _start(state, event, restarts=0 if event.asker is Asker.USER else state.restarts + 1)
            return state, (Release(state.kind, state.detail),)
        case RestartAsked():
            return _start(state, event, restarts=0)
        case StopAsked():
            return Stopped(state.run, state.restarts, event.now_s, by_user=True), ()
    return state, ()


def _start(state: State, event: Event, *, restarts: int) -> Step:
    return Starting(state.run + 1, restarts, event.now_s), (Spawn(state.run + 1),)


def _stop(state: State, event: Event, *, start_again: bool) -> Step:
    patience_s = event.patience_s if isinstance(event, StopAsked) else None
    stopping = Stopping(state.run, state.restarts, event.now_s, start_again, patience_s=patience_s)
    return stopping, (CloseStdin(), Release("stopped"))


def _fail(state: State, event: Event, kind: str, detail: str, *first: Effect) -> Step:
    return Failed(state.run, state.restarts, event.now_s, kind, detail), (*first, Release(kind, detail))
