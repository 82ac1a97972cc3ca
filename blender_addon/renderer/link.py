# SPDX-License-Identifier: GPL-3.0-or-later
"""The link to the engine: pictures of which only the newest matters, and requests that are answered exactly.

One thread owns process and socket (process.py). What everybody else calls takes a lock for some microseconds and
never waits, except `wait`, `wait_until_ready`, `request` and `close`, whose waits are bounded and end with the engine.
What becomes of the process is decided by state.py, who waits for what is kept by waiting.py. Does not use bpy.
Source: BLENDER 3.2 to 3.4 and 5.
"""

from __future__ import annotations

import contextlib
import selectors
import socket
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ..core import protocol
from ..errors import JGHandFailure
from . import state as machine
from .process import EngineProcess
from .waiting import Answer, Arrays, Call, Waiting

__all__ = ["Answer", "EngineLink", "Status"]


@dataclass(frozen=True)
class Status:
    # "stopped", "starting", "ready", "slow", "stopping" or "failed"
    state: str
    # for how many seconds; 0 for one that was never started
    since_s: float
    # why it failed
    failure: JGHandFailure | None = None
    # what the engine said of itself, empty before it did
    handshake: Mapping[str, Any] = field(default_factory=dict)
    # whether it works on something, and what of it takes long, if it says so
    busy: bool = False
    doing: str = ""


class EngineLink:
    """The engine as everybody sees it. Make one, `ask` or `request`, `close` it at the end."""

    def __init__(self, command: Callable[[], Sequence[str]]) -> None:
        """command: how to start the engine, asked at every start in the thread that wants it; may raise
        JGHandFailure."""
        self._command = command
        # of the engine before and of this one, while that printed anything
        self._logs: deque[deque[str]] = deque([deque()], maxlen=2)
        self._news = threading.Condition(threading.RLock())
        # all that follows is read and written under the lock of `_news`
        self._state: machine.State = machine.Stopped()
        self._effects: deque[machine.Effect] = deque()
        self._spawn: Sequence[str] | JGHandFailure = ()
        self._failure: JGHandFailure | None = None
        self._handshake: Mapping[str, Any] = {}
        self._waiting = Waiting()
        self._closing = False
        self._thread: threading.Thread | None = None
        self._waker: socket.socket | None = None
        # these belong to the thread; run: the number under which the machine knows the process
        self._run = 0
        self._engine: EngineProcess | None = None

    # ---- what everybody may call -------------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        with self._news:
            state = self._state
            name = "slow" if _is_slow(state) else type(state).__name__.lower()
            since_s = time.monotonic() - state.since_s if state.since_s else 0.0
            busy = self._waiting.flying is not None
            return Status(name, since_s, self._failure, self._handshake, busy, self._waiting.doing)

    @property
    def log(self) -> str:
        """The last lines that this engine and the one before printed."""
        return "\n".join("\n".join(tuple(lines)) for lines in tuple(self._logs) if lines)

    def start(self, *, by_user: bool = True) -> None:
        """Starts the engine, for a user also one that failed too often; returns at once."""
        with self._news:
            if by_user:
                self._waiting.forget_refused()
            self._want(by_user=by_user)

    def restart(self) -> None:
        """Ends the engine, whatever it does, and starts a new one; returns at once."""
        with self._news:
            self._waiting.forget_refused()
            self._find_command()
            self._handle(machine.RestartAsked(time.monotonic()))

    def close(self) -> None:
        """Ends engine and thread; waits for both, bounded. The link cannot be used afterwards. May be called twice."""
        with self._news:
            now_s, self._closing = time.monotonic(), True
            answers = not _is_slow(self._state) and not self._waiting.is_overdue(now_s)
            self._handle(machine.StopAsked(now_s, machine.CLOSE_S if answers else 0.0))
            self._wake()
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(machine.CLOSE_S + 2 * machine.KILL_S)
        engine = self._engine
        if engine is not None:  # the thread did not come to it
            engine.popen.kill()

    def ask(
        self,
        slot: str,
        header: Mapping[str, Any],
        arrays: Arrays | None,
        tag: Hashable,
        *,
        droppable: bool = False,
    ) -> None:
        """Asks for a picture in place of the one that the slot waits for. The arrays must not change afterwards.

        Starts the engine where that is allowed. A request that failed is not sent again: its failure is the answer.
        droppable: a slow picture, which is given up, also when the engine is at it, as soon as the slot wants another
        one or somebody makes a request. Never a fast one: while everything moves none would ever come.
        """
        with self._news:
            if self._waiting.ask(slot, header, arrays, tag, time.monotonic(), droppable=droppable):
                self._want()
            else:
                self._news.notify_all()
            self._wake()

    def answer(self, slot: str) -> Answer | None:
        """The newest answer of the slot, whatever it asked for since; it stays until the next or until `drop`."""
        with self._news:
            return self._waiting.slot(slot).answer

    def wait(self, slot: str, tag: Hashable, timeout_s: float) -> Answer | None:
        """Waits for the answer with this tag; None when it does not come in time or is not on its way."""
        deadline = time.monotonic() + timeout_s
        with self._news:
            while True:
                place = self._waiting.slot(slot)
                answer = place.answer
                if answer is not None and answer.tag == tag:
                    return answer
                left_s = deadline - time.monotonic()
                if left_s <= 0 or not place.expects(tag) or not self._works():
                    return None
                self._news.wait(min(left_s, machine.POLL_S))

    def drop(self, slot: str) -> None:
        with self._news:
            self._waiting.drop(slot, time.monotonic())
            self._wake()

    def wait_until_ready(self) -> None:
        """Waits for an engine that is starting. Raises JGHandFailure when there will be none."""
        with self._news:
            while isinstance(self._state, machine.Starting | machine.Stopping) and self._works():
                self._news.wait(machine.POLL_S)
            if not isinstance(self._state, machine.Ready):
                raise _copy(self._failure)

    def request(
        self,
        header: Mapping[str, Any],
        arrays: Arrays | None = None,
        *,
        timeout_s: float = machine.REQUEST_S,
        canceled: Callable[[], bool] = lambda: False,
    ) -> protocol.Message:
        """Sends a request and waits for its reply; from any thread. Requests are answered in their order.

        The time counts from when the engine gets it, and not while the engine says what it loads for it, for LOAD_S
        at most. `canceled` is asked again and again; what it raises ends the request, too.
        Raises JGHandFailure: bad_input for what cannot be sent, "canceled", "hung" when the time is over, the engine's
        own kind when it answers with an error, or why there is no engine.
        """
        with self._news:
            call = self._waiting.append(header, arrays, time.monotonic())
            self._want()
            self._wake()
        try:
            while (answer := self._answer_of(call, timeout_s)) is None:
                if canceled():
                    raise JGHandFailure("canceled")
        except BaseException:  # Ctrl-C too: the engine is not to go on with what nobody waits for
            with self._news:
                self._waiting.give_up(call, time.monotonic())
                self._wake()
            raise
        if answer.message is None:
            raise _copy(answer.failure)
        return answer.message

    def _answer_of(self, call: Call, timeout_s: float) -> Answer | None:
        """Its answer, None where a moment's wait brought none; JGHandFailure when it will not come."""
        with self._news:
            if call.answer is not None:
                return call.answer
            left_s = timeout_s if call.begun_s is None else call.begun_s + timeout_s - time.monotonic()
            if left_s <= 0:
                raise self._with_words("hung", "no reply in time")
            if not self._works():
                raise _copy(self._failure)
            self._news.wait(min(machine.POLL_S, left_s))
            return call.answer

    # ---- under the lock ----------------------------------------------------------------------------------------------

    def _want(self, *, by_user: bool = False) -> None:
        """Tells the machine that an engine is wanted; finds the command where that will start one."""
        event = machine.StartAsked(time.monotonic(), by_user)
        if isinstance(self._state, machine.Stopped | machine.Failed) and machine.may_start(self._state, event):
            self._find_command()
        self._handle(event)

    def _find_command(self) -> None:
        """Looks anew for the engine; the thread starts it, or tells why there is none."""
        try:
            self._spawn = tuple(self._command())
        except JGHandFailure as failure:
            self._spawn = failure

    def _handle(self, event: machine.Event) -> None:
        """Feeds an event to the machine; what it decides about answers is done at once, the rest by the thread."""
        with self._news:
            if self._closing and isinstance(event, machine.StartAsked | machine.RestartAsked):
                self._release(JGHandFailure("stopped"))
                return
            before = self._state
            self._state, effects = machine.transition(before, event)
            if not isinstance(self._state, machine.Failed):
                self._failure = None
            elif self._state is not before:
                self._failure = self._with_words(self._state.kind, self._state.detail)
            for effect in effects:
                if isinstance(effect, machine.Release):
                    self._release(self._failure or JGHandFailure(effect.kind, effect.detail))
                else:
                    self._effects.append(effect)
            if type(before) is not type(self._state) or _is_slow(before) != _is_slow(self._state):
                if not isinstance(self._state, machine.Ready):
                    self._handshake = {}
                self._news.notify_all()
                self._wake()

    def _release(self, failure: JGHandFailure) -> None:
        self._waiting.release(failure)
        self._news.notify_all()

    def _with_words(self, kind: str, detail: str = "") -> JGHandFailure:
        """A failure of the engine with what it printed last."""
        lines = tuple(self._logs[-1])
        words = "\n".join(lines[-machine.DETAIL_LINES :])
        return JGHandFailure(kind, "\n".join(part for part in (detail, words) if part), log="\n".join(lines))

    def _works(self) -> bool:
        """Whether the thread that will answer lives."""
        return self._thread is not None and self._thread.is_alive()

    def _wake(self) -> None:
        """Makes the thread look now; starts it where there is something for it to do."""
        with self._news:
            if self._thread is None and self._effects:
                woken, self._waker = socket.socketpair()
                for end in (woken, self._waker):
                    end.setblocking(False)
                self._thread = threading.Thread(target=self._work, args=(woken,), daemon=True, name="jghand link")
                self._thread.start()
            if self._waker is not None:
                with contextlib.suppress(OSError):  # full: it is awake already; closed: it has ended
                    self._waker.send(b"\0")

    # ---- the thread --------------------------------------------------------------------------------------------------

    def _work(self, woken: socket.socket) -> None:
        try:
            while not self._is_over():
                self._do_effects()
                self._look_at_engine()
                self._send_next()
                self._sleep(woken)
                self._look_at_engine()
                self._look_at_clock()
        except Exception as error:  # a mistake of ours must not leave anybody waiting
            traceback.print_exc()
            self._end_engine()
            with self._news:
                self._effects.clear()
                for event in (machine.Broke, machine.Exited):
                    self._handle(event(time.monotonic(), self._state.run, "internal", repr(error)))
        finally:
            self._end_engine()
            with self._news:
                waker, self._waker, self._thread = self._waker, None, None
                self._news.notify_all()
                if self._effects:  # somebody wants it again already
                    self._wake()
            for end in (woken, waker):
                if end is not None:
                    end.close()

    def _is_over(self) -> bool:
        with self._news:
            return self._closing and self._rests() and not self._effects

    def _rests(self) -> bool:
        return isinstance(self._state, machine.Stopped | machine.Failed)

    def _do_effects(self) -> None:
        while True:
            with self._news:
                if not self._effects:
                    return
                effect, spawn = self._effects.popleft(), self._spawn
            match effect:
                case machine.Spawn():
                    self._start_engine(effect.run, spawn)
                case machine.Kill():
                    self._end_engine()
                    self._handle(machine.Exited(time.monotonic(), self._run, "killed"))
                case machine.CloseStdin() if self._engine is not None:
                    self._engine.close_stdin()

    def _start_engine(self, run: int, spawn: Sequence[str] | JGHandFailure) -> None:
        self._end_engine()
        self._run, log = run, deque[str](maxlen=machine.LOG_LINES)
        if self._logs[-1]:
            self._logs.append(log)
        else:
            self._logs[-1] = log
        try:
            if isinstance(spawn, JGHandFailure):
                raise spawn
            self._engine = EngineProcess(spawn, log, self._wake)
        except JGHandFailure as failure:
            self._handle(machine.Exited(time.monotonic(), run, failure.kind, failure.detail))

    def _end_engine(self) -> None:
        engine, self._engine = self._engine, None
        if engine is not None:
            engine.kill()

    def _look_at_engine(self) -> None:
        """Takes in what has come: the handshake, messages, the end of the process."""
        engine = self._engine
        if engine is None:
            return
        try:
            engine.connect()
            engine.send(())
            while (message := engine.receive()) is not None:
                self._take(message, engine)
        except JGHandFailure as lost:
            self._handle(machine.Broke(time.monotonic(), self._run, lost.kind, lost.detail))
        ended = engine.why_it_ended()
        if ended is not None:
            self._end_engine()
            self._handle(machine.Exited(time.monotonic(), self._run, ended.kind, ended.detail))

    def _take(self, message: protocol.Message, engine: EngineProcess) -> None:
        now_s = time.monotonic()
        with self._news:
            if isinstance(self._state, machine.Starting):  # this was its welcome
                self._handshake = engine.handshake
                self._handle(machine.Greeted(now_s, self._run))
                return
            self._handle(machine.Heard(now_s, self._run))
            if message.header.get("kind") != "heartbeat":
                self._waiting.take(message, now_s)
                self._news.notify_all()

    def _send_next(self) -> None:
        """Tells the engine what nobody wants any more, and gives it its next request when it has none."""
        engine = self._engine
        with self._news:
            pieces: list[bytes | memoryview] = []
            while self._waiting.cancels:
                pieces += protocol.encode({"kind": "cancel", "id": self._waiting.cancels.popleft()})
            if isinstance(self._state, machine.Ready) and engine is not None:
                call = self._waiting.next(time.monotonic())
                if call is not None:
                    if call.kept not in ("", engine.kept):
                        engine.kept = call.kept
                        pieces += call.keeping
                    pieces += call.pieces
        if engine is not None:
            engine.send(pieces)

    def _sleep(self, woken: socket.socket) -> None:
        """Until something comes, or it is time to look at the clock."""
        with self._news:
            if self._effects or self._is_over():
                return
            patience_s = machine.LOOK_S if isinstance(self._state, machine.Ready) else machine.POLL_S
            if self._rests():
                patience_s = None
        # not select.select, which knows only the first 1024 handles of a process
        with selectors.DefaultSelector() as selector:
            selector.register(woken, selectors.EVENT_READ)
            engine = self._engine
            if engine is not None and engine.socket is not None:
                writes = selectors.EVENT_WRITE if engine.outgoing else 0
                selector.register(engine.socket, selectors.EVENT_READ | writes)
            ready = [key.fileobj for key, _ in selector.select(patience_s)]
        if woken in ready:
            with contextlib.suppress(BlockingIOError):
                while woken.recv(4096):
                    pass

    def _look_at_clock(self) -> None:
        now_s = time.monotonic()
        with self._news:
            if isinstance(self._state, machine.Ready) and self._waiting.is_overdue(now_s):
                self._handle(machine.Broke(now_s, self._run, "hung", "a request does not end"))
            self._handle(machine.Tick(now_s))


def _is_slow(state: machine.State) -> bool:
    return isinstance(state, machine.Ready) and state.slow


def _copy(failure: JGHandFailure | None) -> JGHandFailure:
    """To be raised: one that is kept would hold on to the frames that it went through."""
    if failure is None:
        return JGHandFailure("stopped")
    return JGHandFailure(failure.kind, failure.detail, log=failure.log)
