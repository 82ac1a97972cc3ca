# SPDX-License-Identifier: GPL-3.0-or-later
"""The link to the engine: pictures of which only the newest matters, and requests that are answered exactly.

One thread owns process and socket. What everybody else calls takes a lock for some microseconds and never waits,
except `wait`, `request` and `close`, whose waits are bounded and end with the engine. What happens to the process is
decided by state.py. Does not use bpy. Source: BLENDER 3.2 to 3.4 and 5.
"""

from __future__ import annotations

import contextlib
import os
import select
import socket
import threading
import time
import traceback
from collections import OrderedDict, deque
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from . import limits
from . import state as machine
from .messages import JGHandFailure
from .process import EngineLog, EngineProcess
from .state import Asker
from .wire import protocol

Arrays = Mapping[str, protocol.Array]


@dataclass(frozen=True)
class Status:
    """state: "stopped", "starting", "ready", "slow", "stopping" or "failed"; since_s: for how many seconds (0 for one
    that was never started); failure: why it failed; handshake: what the engine said of itself, empty before it did;
    busy: whether it works on something."""

    state: str
    since_s: float
    failure: JGHandFailure | None = None
    handshake: Mapping[str, Any] = field(default_factory=dict)
    busy: bool = False


@dataclass(frozen=True)
class Answer:
    """To the request with this tag: the engine's message, or a failure."""

    tag: Hashable
    message: protocol.Message | None
    failure: JGHandFailure | None = None
    round_trip_ms: float = 0.0


@dataclass(frozen=True)
class Progress:
    """fraction: 0 to 1, None where it is not known; eta_s: seconds left, None where they are not known."""

    fraction: float | None
    text: str = ""
    eta_s: float | None = None


@dataclass(eq=False)
class _Call:
    """One request on its way. slot: None for an exact one."""

    id: int
    pieces: list[bytes | memoryview]
    slot: str | None = None
    tag: Hashable = None
    sent_s: float = 0.0
    # when nobody wants the answer any more but the engine still works on it
    given_up_s: float | None = None
    answer: Answer | None = None


@dataclass
class _Slot:
    """A consumer of pictures: what it wants now, and what it has."""

    waiting: _Call | None = None
    flying: _Call | None = None
    answer: Answer | None = None


class EngineLink:
    """The engine as everybody sees it. Make one, `ask` or `request`, `close` it at the end."""

    def __init__(
        self,
        command: Callable[[], Sequence[str]],
        *,
        log_folder: Path | None = None,
        environment: Mapping[str, str] = os.environ,
    ) -> None:
        """command: how to start the engine, asked at every start in the thread that wants it; may raise JGHandFailure.
        log_folder: where what the engine prints is kept; None: only its last lines in memory."""
        self._command, self._environment = command, environment
        self._log = EngineLog(log_folder)
        self._changed_condition = threading.Condition(threading.RLock())
        # all that follows is read and written under the lock
        self._state: machine.State = machine.Stopped()
        self._effects: deque[machine.Effect] = deque()
        self._spawn: Sequence[str] | JGHandFailure = ()
        self._failure: JGHandFailure | None = None
        self._slots: OrderedDict[str, _Slot] = OrderedDict()
        self._exact: deque[_Call] = deque()
        self._flying: _Call | None = None
        self._cancels: deque[int] = deque()
        self._refused: OrderedDict[Hashable, JGHandFailure] = OrderedDict()
        self._progress: Progress | None = None
        self._handshake: Mapping[str, Any] = {}
        self._next_id = 1
        self._changed = False
        self._closing = False
        self._thread: threading.Thread | None = None
        self._wake_sender: socket.socket | None = None
        # these belong to the thread; run: the number under which the machine knows the process
        self._run = 0
        self._process: EngineProcess | None = None
        self._connection: socket.socket | None = None
        self._receiver: protocol.Receiver | None = None
        self._outgoing: deque[memoryview] = deque()

    # ---- what everybody may call -------------------------------------------------------------------------------------

    @property
    def status(self) -> Status:
        """How the engine is now."""
        with self._changed_condition:
            name = {
                machine.Stopped: "stopped",
                machine.Starting: "starting",
                machine.Ready: "ready",
                machine.Stopping: "stopping",
                machine.Failed: "failed",
            }[type(self._state)]
            if isinstance(self._state, machine.Ready) and self._state.slow:
                name = "slow"
            since_s = time.monotonic() - self._state.since_s if self._state.since_s else 0.0
            failure = self._failure if name == "failed" else None
            return Status(name, since_s, failure, self._handshake, self._flying is not None)

    @property
    def log(self) -> str:
        """The last lines that the engine printed."""
        return self._log.last()

    @property
    def log_path(self) -> Path | None:
        """The file with all that this engine printed; None where none is written."""
        return self._log.path

    def progress(self) -> Progress | None:
        """How far the request is that the engine works on, if it says so."""
        with self._changed_condition:
            return self._progress

    def start(self) -> None:
        """Starts the engine, also one that was stopped on purpose or failed too often; returns at once."""
        with self._changed_condition:
            self._refused.clear()
            self._ask_to_start(Asker.USER)

    def stop(self) -> None:
        """Ends the engine; returns at once. Pictures do not start it again, `start` and `request` do."""
        with self._changed_condition:
            self._handle(machine.StopAsked(time.monotonic()))

    def restart(self) -> None:
        """Ends the engine, whatever it does, and starts a new one; returns at once."""
        with self._changed_condition:
            self._refused.clear()
            self._find_command()
            self._handle(machine.RestartAsked(time.monotonic()))

    def close(self) -> None:
        """Ends engine and thread; waits for both, bounded. The link cannot be used afterwards. May be called twice."""
        with self._changed_condition:
            self._closing = True
            self._handle(machine.StopAsked(time.monotonic()))
            self._wake()
            thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join(limits.STOP_S + 3 * limits.TERMINATE_S)
        process = self._process
        if process is not None and process.runs:
            process.kill()

    def tick(self) -> bool:
        """Whether anything changed since the last call: an answer came, or the engine's state is another."""
        with self._changed_condition:
            changed, self._changed = self._changed, False
            return changed

    def ask(self, slot: str, header: Mapping[str, Any], arrays: Arrays | None, tag: Hashable) -> None:
        """Asks for a picture in place of the one that the slot waits for. The arrays must not change afterwards.

        Starts the engine where that is allowed. A request that failed is not sent again: its failure is the answer.
        """
        with self._changed_condition:
            place = self._slots.setdefault(slot, _Slot())
            if any(call is not None and call.tag == tag for call in (place.waiting, place.flying)):
                if place.waiting is not None and place.waiting.tag != tag:
                    place.waiting = None  # what flies already is wanted again
                return
            failure = self._refused.get(tag)
            if failure is None:
                try:
                    place.waiting = self._new_call(header, arrays, slot, tag)
                except JGHandFailure as error:
                    failure = error
            if failure is not None:
                place.waiting = None
                self._answer_slot(place, Answer(tag, None, failure))
                return
            self._ask_to_start(Asker.PICTURE)
            self._wake()

    def answer(self, slot: str) -> Answer | None:
        """The newest answer of the slot, whatever it asked for since; it stays until the next or until `drop`."""
        with self._changed_condition:
            place = self._slots.get(slot)
            return place.answer if place is not None else None

    def wait(self, slot: str, tag: Hashable, timeout_s: float) -> Answer | None:
        """Waits for the answer with this tag; None when it does not come in time or is not on its way."""
        deadline = time.monotonic() + timeout_s
        with self._changed_condition:
            while True:
                place = self._slots.get(slot)
                if place is None:
                    return None
                if place.answer is not None and place.answer.tag == tag:
                    return place.answer
                left_s = deadline - time.monotonic()
                coming = any(call is not None and call.tag == tag for call in (place.waiting, place.flying))
                if left_s <= 0 or not coming or not self._works():
                    return None
                self._changed_condition.wait(min(left_s, limits.POLL_S))

    def drop(self, slot: str) -> None:
        """Forgets a slot and what it waits for."""
        with self._changed_condition:
            place = self._slots.pop(slot, None)
            if place is not None and place.flying is not None:
                self._give_up(place.flying)

    def wait_until_ready(self) -> None:
        """Waits for an engine that is starting. Raises JGHandFailure when there will be none."""
        with self._changed_condition:
            while isinstance(self._state, machine.Starting | machine.Stopping) and self._works():
                self._changed_condition.wait(limits.POLL_S)
            if not isinstance(self._state, machine.Ready):
                raise self._failure or JGHandFailure("stopped")

    def request(
        self,
        header: Mapping[str, Any],
        arrays: Arrays | None = None,
        *,
        timeout_s: float = limits.REQUEST_S,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> protocol.Message:
        """Sends a request and waits for its reply; from any thread. Requests are answered in their order.

        The time counts from when the engine is ready. `cancelled` is asked again and again.
        Raises JGHandFailure: bad_input for what cannot be sent, "cancelled", "hung" when the time is over, the engine's
        own kind when it answers with an error, or why there is no engine.
        """
        with self._changed_condition:
            call = self._new_call(header, arrays)
            self._exact.append(call)
            self._ask_to_start(Asker.WORK)
            self._wake()
        deadline = time.monotonic() + timeout_s
        while True:
            with self._changed_condition:
                if call.answer is not None:
                    break
                now_s = time.monotonic()
                if not isinstance(self._state, machine.Ready):
                    deadline = now_s + timeout_s
                if now_s > deadline:
                    self._give_up(call)
                    raise self._with_words("hung", "no reply in time")
                if not self._works():
                    raise self._failure or self._with_words("stopped")
                self._changed_condition.wait(max(0.0, min(limits.POLL_S, deadline - now_s)))
            if cancelled():
                with self._changed_condition:
                    self._give_up(call)
                raise JGHandFailure("cancelled")
        if call.answer.failure is not None:
            raise call.answer.failure
        assert call.answer.message is not None  # an answer is one or the other
        return call.answer.message

    # ---- under the lock ----------------------------------------------------------------------------------------------

    def _new_call(
        self, header: Mapping[str, Any], arrays: Arrays | None, slot: str | None = None, tag: Hashable = None
    ) -> _Call:
        identity, self._next_id = self._next_id, self._next_id + 1
        try:
            pieces = protocol.encode({**header, "id": identity}, arrays)
        except protocol.ProtocolError as error:
            raise JGHandFailure("bad_input", str(error)) from error
        return _Call(identity, pieces, slot, tag)

    def _ask_to_start(self, asker: Asker) -> None:
        """Tells the machine that an engine is wanted; finds the command where that will start one."""
        now_s = time.monotonic()
        idle = isinstance(self._state, machine.Stopped | machine.Failed | machine.Stopping)
        if idle and machine.may_start(self._state, asker, now_s):
            self._find_command()
        self._handle(machine.StartAsked(now_s, asker))

    def _find_command(self) -> None:
        """Looks anew for the engine; the thread starts it, or tells why there is none."""
        try:
            self._spawn = tuple(self._command())
        except JGHandFailure as failure:
            self._spawn = failure

    def _handle(self, event: machine.Event) -> None:
        """Feeds an event to the machine; what it decides about answers is done at once, the rest by the thread."""
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
                failed = isinstance(self._state, machine.Failed) and self._failure is not None
                self._release(self._failure if failed else JGHandFailure(effect.kind, effect.detail))
            else:
                self._effects.append(effect)
        slow = isinstance(before, machine.Ready) and isinstance(self._state, machine.Ready)
        if type(before) is not type(self._state) or (slow and before.slow != self._state.slow):
            if not isinstance(self._state, machine.Ready):
                self._handshake = {}
            self._changed = True
            self._changed_condition.notify_all()
            self._wake()

    def _release(self, failure: JGHandFailure) -> None:
        """Everybody who waits gets this failure; what the engine worked on when it failed is not asked for again."""
        flying, self._flying, self._progress = self._flying, None, None
        if flying is not None and flying.slot is not None and failure.kind in machine.PASSING:
            self._refuse(flying.tag, failure)
        for call in (flying, *self._exact):
            if call is not None and call.slot is None:
                call.answer = Answer(call.tag, None, failure)
        self._exact.clear()
        self._cancels.clear()
        for place in self._slots.values():
            wanted = place.waiting or place.flying
            place.waiting = place.flying = None
            if wanted is not None:
                self._answer_slot(place, Answer(wanted.tag, None, failure))
        self._changed_condition.notify_all()

    def _answer_slot(self, place: _Slot, answer: Answer) -> None:
        if _says_the_same(place.answer, answer):
            return  # or a view that is drawn again for every answer, and asks when it is drawn, would never rest
        place.answer = answer
        self._changed = True
        self._changed_condition.notify_all()

    def _refuse(self, tag: Hashable, failure: JGHandFailure) -> None:
        self._refused[tag] = failure
        while len(self._refused) > limits.REFUSED_MAX:
            self._refused.popitem(last=False)

    def _give_up(self, call: _Call) -> None:
        """Nobody wants this answer any more."""
        if call in self._exact:
            self._exact.remove(call)
        elif call is self._flying and call.given_up_s is None:
            call.given_up_s = time.monotonic()
            self._cancels.append(call.id)
            self._wake()

    def _with_words(self, kind: str, detail: str = "") -> JGHandFailure:
        """A failure of the engine with what it printed last."""
        words = self._log.last(limits.DETAIL_LINES)
        return JGHandFailure(kind, "\n".join(part for part in (detail, words) if part), log=self._log.last())

    def _works(self) -> bool:
        """Whether the thread that will answer lives."""
        return self._thread is not None and self._thread.is_alive()

    def _wake(self) -> None:
        """Makes the thread look now; starts it where there is something for it to do."""
        if self._thread is None and self._effects:
            receiver, self._wake_sender = socket.socketpair()
            for end in (receiver, self._wake_sender):
                end.setblocking(False)
            self._thread = threading.Thread(target=self._work, args=(receiver,), daemon=True, name="jghand link")
            self._thread.start()
        if self._wake_sender is not None:
            with contextlib.suppress(OSError):  # full: it is awake already; closed: it has ended
                self._wake_sender.send(b"\0")

    # ---- the thread --------------------------------------------------------------------------------------------------

    def _work(self, wake: socket.socket) -> None:
        try:
            while not self._is_over():
                self._do_effects()
                self._look_at_process()
                self._send_next()
                self._look_at_sockets(wake)
                self._look_at_clock()
        except Exception as error:  # a mistake of ours must not leave anybody waiting
            self._log.write(traceback.format_exc())
            self._forget_process(kill=True)
            with self._changed_condition:
                self._effects.clear()
                self._handle(machine.Broke(time.monotonic(), self._state.run, "internal", repr(error)))
                self._handle(machine.Exited(time.monotonic(), self._state.run, "internal", repr(error)))
        finally:
            self._forget_process(kill=True)
            with self._changed_condition:
                sender, self._wake_sender, self._thread = self._wake_sender, None, None
                self._changed_condition.notify_all()
                if self._effects:  # somebody wants it again already
                    self._wake()
            for end in (wake, sender):
                if end is not None:
                    end.close()

    def _is_over(self) -> bool:
        with self._changed_condition:
            over = isinstance(self._state, machine.Stopped | machine.Failed)
            return self._closing and over and not self._effects

    def _do_effects(self) -> None:
        while True:
            with self._changed_condition:
                if not self._effects:
                    return
                effect = self._effects.popleft()
                spawn = self._spawn
            match effect:
                case machine.Spawn():
                    self._start_process(effect.run, spawn)
                case machine.Kill():
                    self._forget_process(kill=True)
                    self._say(machine.Exited(time.monotonic(), self._run, "killed"))
                case machine.CloseStdin() if self._process is not None:
                    self._process.close_stdin()
                case machine.Terminate() if self._process is not None:
                    self._process.terminate()

    def _start_process(self, run: int, spawn: Sequence[str] | JGHandFailure) -> None:
        self._forget_process(kill=True)
        self._run = run
        try:
            if isinstance(spawn, JGHandFailure):
                raise spawn
            self._log.begin()
            self._process = EngineProcess(
                spawn, self._log, environment=self._environment, wake=self._wake_from_elsewhere
            )
        except JGHandFailure as failure:
            self._say(machine.Exited(time.monotonic(), run, failure.kind, failure.detail))

    def _wake_from_elsewhere(self) -> None:
        with self._changed_condition:
            self._wake()

    def _say(self, event: machine.Event) -> None:
        with self._changed_condition:
            self._handle(event)

    def _look_at_process(self) -> None:
        """Notices the handshake and the end of the process."""
        process, run = self._process, self._run
        if process is None:
            return
        if not process.runs:
            self._read()  # what it said before it ended
            kind, detail = process.why_it_ended()
            self._forget_process(kill=False)
            self._say(machine.Exited(time.monotonic(), run, kind, detail))
        elif self._connection is None and process.handshake is not None and isinstance(self._state, machine.Starting):
            try:
                self._connect(process, process.handshake)
            except JGHandFailure as failure:
                self._say(machine.Broke(time.monotonic(), run, failure.kind, failure.detail))
            except (OSError, ValueError, TypeError) as error:
                self._lose(run, "broken_stream", str(error))

    def _connect(self, process: EngineProcess, handshake: Mapping[str, Any]) -> None:
        theirs = handshake.get("protocol")
        if theirs != protocol.PROTOCOL_VERSION:
            raise JGHandFailure("protocol", f"extension {protocol.PROTOCOL_VERSION}, engine {theirs}")
        address = ("127.0.0.1", int(handshake.get("port", 0)))
        self._connection = socket.create_connection(address, timeout=limits.WELCOME_S)
        self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._connection.setblocking(False)
        self._receiver = protocol.Receiver(self._connection)
        self._outgoing.append(memoryview(protocol.greeting(process.token)))

    def _lose(self, run: int, kind: str, detail: str) -> None:
        """The connection broke; when that is because the process ends, that is told instead."""
        process = self._process
        if process is not None and process.ends_within(limits.TERMINATE_S):
            kind, detail = process.why_it_ended()
        self._say(machine.Broke(time.monotonic(), run, kind, detail))

    def _forget_process(self, *, kill: bool) -> None:
        self._disconnect()
        if self._process is not None:
            if kill:
                self._process.kill()
            self._process.close_stdin()
            self._log.end()
        self._process = None

    def _send_next(self) -> None:
        """Gives the engine its next request: exact ones first, then the slot that waits longest."""
        with self._changed_condition:
            while self._cancels:
                self._queue(protocol.encode({"kind": "cancel", "id": self._cancels.popleft()}))
            if self._flying is not None or not isinstance(self._state, machine.Ready):
                return
            call = self._exact.popleft() if self._exact else self._next_of_slots()
            if call is None:
                return
            self._flying, call.sent_s = call, time.monotonic()
            self._queue(call.pieces)
        self._flush()

    def _next_of_slots(self) -> _Call | None:
        for name, place in self._slots.items():
            if place.waiting is not None:
                place.flying, place.waiting = place.waiting, None
                self._slots.move_to_end(name)
                return place.flying
        return None

    def _queue(self, pieces: Sequence[bytes | memoryview]) -> None:
        if self._connection is not None:
            self._outgoing.extend(memoryview(piece).cast("B") for piece in pieces)

    def _look_at_sockets(self, wake: socket.socket) -> None:
        connection = self._connection
        readable = [wake] if connection is None else [wake, connection]
        writable = [connection] if connection is not None and self._outgoing else []
        ready, _, _ = select.select(readable, writable, [], self._patience_s())
        if wake in ready:
            with contextlib.suppress(BlockingIOError):
                while wake.recv(4096):
                    pass
        if connection is not None:
            self._flush()
            self._read()

    def _patience_s(self) -> float | None:
        """How long the thread may sleep; it is woken by whatever comes."""
        with self._changed_condition:
            if self._effects or (self._closing and isinstance(self._state, machine.Stopped | machine.Failed)):
                return 0.0
            if isinstance(self._state, machine.Stopped | machine.Failed):
                return None
            return limits.LOOK_S if isinstance(self._state, machine.Ready) else limits.POLL_S

    def _flush(self) -> None:
        """Sends as much as the connection takes."""
        try:
            while self._outgoing and self._connection is not None:
                sent = self._connection.send(self._outgoing[0])
                if sent < self._outgoing[0].nbytes:
                    self._outgoing[0] = self._outgoing[0][sent:]
                else:
                    self._outgoing.popleft()
        except (BlockingIOError, InterruptedError):
            return
        except OSError:  # the reading side says what is the matter
            self._outgoing.clear()

    def _read(self) -> None:
        """Takes in all that has come."""
        run = self._run
        try:
            while self._receiver is not None and (message := self._receiver.receive()) is not None:
                self._say(machine.Heard(time.monotonic(), run))
                self._take(message, run)
        except protocol.Disconnected as error:
            # an engine that does not know the token leaves without a word
            starting = isinstance(self._state, machine.Starting)
            self._disconnect()
            if not isinstance(self._state, machine.Stopping):
                self._lose(run, "token" if starting else "broken_stream", str(error))
        except (protocol.ProtocolError, OSError) as error:
            self._disconnect()
            self._say(machine.Broke(time.monotonic(), run, "broken_stream", str(error)))

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
        self._connection = self._receiver = None
        self._outgoing.clear()

    def _take(self, message: protocol.Message, run: int) -> None:
        kind = message.header.get("kind")
        with self._changed_condition:
            if isinstance(self._state, machine.Starting):
                if kind == "welcome" and self._process is not None:
                    self._handshake = self._process.handshake or {}
                    self._handle(machine.Greeted(time.monotonic(), run))
                elif kind != "heartbeat":
                    told = _told(message.header.get("error"), "")
                    self._handle(machine.Broke(time.monotonic(), run, told.kind, told.detail))
            elif kind == "reply":
                self._take_reply(message)
            elif kind == "progress" and self._flying is not None and message.header.get("id") == self._flying.id:
                self._progress = _progress(message.header)
                self._changed = True

    def _take_reply(self, message: protocol.Message) -> None:
        call = self._flying
        if call is None or message.header.get("id") != call.id:
            return
        self._flying = self._progress = None
        failure = None if message.header.get("ok") is True else _told(message.header.get("error"), self._log.last())
        took_ms = 1e3 * (time.monotonic() - call.sent_s)
        answer = Answer(call.tag, None if failure else message, failure, took_ms)
        if call.slot is None:
            call.answer = answer
            self._changed_condition.notify_all()
            return
        place = self._slots.get(call.slot)
        if failure is not None and failure.kind not in ("cancelled", "stopped"):
            self._refuse(call.tag, failure)
        if place is not None and place.flying is call:
            place.flying = None
            self._answer_slot(place, answer)

    def _look_at_clock(self) -> None:
        now_s = time.monotonic()
        with self._changed_condition:
            call = self._flying
            if call is not None and isinstance(self._state, machine.Ready):
                given_up = call.given_up_s is not None and now_s - call.given_up_s > limits.SILENCE_S
                if given_up or (call.slot is not None and now_s - call.sent_s > limits.LOAD_S):
                    self._handle(machine.Broke(now_s, self._run, "hung", "a request does not end"))
            self._handle(machine.Tick(now_s))


def _says_the_same(before: Answer | None, now: Answer) -> bool:
    """Whether the same request failed for the same reason."""
    if before is None or before.tag != now.tag or before.failure is None or now.failure is None:
        return False
    return (before.failure.kind, before.failure.detail) == (now.failure.kind, now.failure.detail)


def _told(error: Any, log: str) -> JGHandFailure:
    """The failure that the engine reports; its own sentence is the detail."""
    if not isinstance(error, dict):
        return JGHandFailure("broken_stream", "an error without a description", log=log)
    detail = "\n".join(str(error[key]) for key in ("sentence", "detail") if error.get(key))
    return JGHandFailure(str(error.get("kind")), detail, log=log)


def _progress(header: Mapping[str, Any]) -> Progress:
    """Progress as the engine says it; what is no number is not known."""

    def number(name: str) -> float | None:
        value = header.get(name)
        return float(value) if isinstance(value, int | float) and not isinstance(value, bool) else None

    fraction = number("fraction")
    text = header.get("text")
    return Progress(
        None if fraction is None else min(max(fraction, 0.0), 1.0),
        text if isinstance(text, str) else "",
        number("eta_s"),
    )
