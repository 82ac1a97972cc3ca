# SPDX-License-Identifier: GPL-3.0-or-later
"""What becomes of the engine's process: states, events, and the one function that decides. Source: BLENDER 3.4 and 4.

`transition(state, event) -> (state, effects)` is pure: no clock (the time is in the event), no process, no lock.
Whoever calls it carries the effects out in order. Events of a process carry the number of its run, so that the end of
an earlier one, heard late, is not taken for the end of the present one.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

# ---- numbers of the process, which all that has to do with it reads --------------------------------------------------

# a cold start of the renderer's Python on a slow disk
HANDSHAKE_S = 30.0
# one picture of the final preset, and the loading of an avatar (which imports torch)
REQUEST_S, LOAD_S = 60.0, 120.0
# no sign of life for so long: the renderer is slow, then it hangs (it gives one every second)
SLOW_S, SILENCE_S = 5.0, 30.0
# how often a wait looks whether the process still lives; the link's thread, while the renderer is ready, is woken by
# whatever comes and looks this often besides
POLL_S, LOOK_S = 0.05, 1.0
# between two starts after a failure, and how many of them there are unless the user asks for one
RESTART_S, RESTARTS_MAX = 5.0, 3
# pictures that failed and are not asked for again, the newest
REFUSED_MAX = 64
# after stdin was closed the renderer may finish; then it is ended. At the end of Blender, or of the extension, somebody
# waits for that, and the renderer has nothing that it must finish
STOP_S, CLOSE_S = 3.0, 0.3
# what was ended is gone within moments; what is not hangs in the system
KILL_S = 1.0
# after a connection broke, its process may be about to end
TERMINATE_S = 2.0
# lines of the renderer's own output that are kept, those of them that a failure's detail shows, and letters of one
LOG_LINES, DETAIL_LINES, LOG_LINE_MAX = 1000, 20, 2000


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
    """There is no process: before the first wish for one, and after the end."""


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
        return self.silent_s > SLOW_S


@dataclass(frozen=True)
class Stopping(State):
    """Its stdin was closed. start_again: it is being restarted; patience_s: after so long it is ended."""

    start_again: bool = False
    patience_s: float = 0.0


@dataclass(frozen=True)
class Failed(State):
    """kind: a key of errors.ADVICE; detail: what happened, without the engine's own words."""

    kind: str = "crashed"
    detail: str = ""


# ---- events ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Event:
    """now_s: when it happened."""

    now_s: float


@dataclass(frozen=True)
class StartAsked(Event):
    """Somebody wants an engine. by_user: a button, which always starts one; else a picture or a request does."""

    by_user: bool = False


@dataclass(frozen=True)
class StopAsked(Event):
    """The end of the extension. patience_s: how long it waits for the engine to end."""

    patience_s: float


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
class Kill:
    """End the process and forget the connection."""


@dataclass(frozen=True)
class Release:
    """Answer everybody who waits with this failure."""

    kind: str
    detail: str = ""


Effect = Spawn | CloseStdin | Kill | Release
Step = tuple[State, tuple[Effect, ...]]


# ---- decisions -------------------------------------------------------------------------------------------------------


def transition(state: State, event: Event) -> Step:
    """The next state and what is to be done. What does not matter in a state changes nothing."""
    if isinstance(event, OfRun) and event.run != state.run:
        return state, ()
    now_s = event.now_s
    match state, event:
        case (Stopped(), StartAsked()) | (Stopped() | Failed(), RestartAsked()):
            return _start(state, now_s)
        case Failed(), StartAsked() if may_start(state, event):
            return _start(state, now_s, restarts=0 if event.by_user else state.restarts + 1)
        case Failed(), StartAsked():
            return state, (Release(state.kind, state.detail),)
        case Failed(), StopAsked():
            return Stopped(state.run, since_s=now_s), ()
        case Starting() | Ready(), Exited():
            return _fail(state, now_s, event.kind, event.detail)
        case Starting() | Ready(), Broke():
            return _fail(state, now_s, event.kind, event.detail, Kill())
        case Starting() | Ready(), RestartAsked():
            return Stopping(state.run, state.restarts, now_s, True, STOP_S), (CloseStdin(), Release("stopped"))
        case Starting() | Ready() | Stopping(), StopAsked():
            stopping = Stopping(state.run, state.restarts, now_s, False, event.patience_s)
            return stopping, (CloseStdin(), Release("stopped"))
        case Starting(), Greeted():
            return Ready(state.run, state.restarts, now_s, looked_s=now_s), ()
        case Starting(), Tick() if now_s - state.since_s > HANDSHAKE_S:
            return _fail(state, now_s, "start_timeout", "", Kill())
        case Ready(), Heard():
            return replace(state, silent_s=0.0, looked_s=now_s), ()
        case Ready(), Tick():
            # a computer that slept, or a thread that got no turn, has not listened
            silent_s = state.silent_s + min(max(now_s - state.looked_s, 0.0), 2 * LOOK_S)
            if silent_s > SILENCE_S:
                return _fail(state, now_s, "hung", "no sign of life", Kill())
            return replace(state, silent_s=silent_s, looked_s=now_s), ()
        case Stopping(), Exited():
            return _start(state, now_s) if state.start_again else (Stopped(state.run, since_s=now_s), ())
        case Stopping(), Tick() if now_s - state.since_s > state.patience_s:
            return state, (Kill(),)
        case Stopping(), RestartAsked():
            return replace(state, start_again=True), ()
    return state, ()


def may_start(state: State, event: StartAsked) -> bool:
    """Whether a wish for an engine leads to one: it is there, on its way, or may be started now."""
    if not isinstance(state, Failed) or event.by_user:
        return True
    waited = event.now_s - state.since_s >= RESTART_S
    return waited and state.kind in PASSING and state.restarts < RESTARTS_MAX


def _start(state: State, now_s: float, *, restarts: int = 0) -> Step:
    return Starting(state.run + 1, restarts, now_s), (Spawn(state.run + 1),)


def _fail(state: State, now_s: float, kind: str, detail: str, *first: Effect) -> Step:
    return Failed(state.run, state.restarts, now_s, kind, detail), (*first, Release(kind, detail))
