# SPDX-License-Identifier: GPL-3.0-or-later
"""One engine as the link's thread has it: its process and the socket to it. Only `kill` and the search for the reason
of a break wait, and not for long. Does not use bpy. Source: BLENDER 3.1 and 3.2."""

from __future__ import annotations

import os
import socket
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

from ..core import limits
from ..core.wire import protocol
from .answers import told
from .process import EngineLog, EngineProcess


class LostError(Exception):
    """The engine cannot be used any more. kind: a key of messages.ADVICE; detail: what happened."""

    def __init__(self, kind: str, detail: str) -> None:
        super().__init__(kind, detail)
        self.kind, self.detail = kind, detail


class EngineConnection:
    """A process that was started; `connect` when it has said where it listens; then messages. All raise LostError."""

    def __init__(
        self,
        command: Sequence[str],
        log: EngineLog,
        *,
        environment: Mapping[str, str] = os.environ,
        wake: Callable[[], None] = lambda: None,
    ) -> None:
        """wake: called from another thread when there is something to look at. JGHandFailure: no_interpreter."""
        self._log = log
        self.process = EngineProcess(command, log, environment=environment, wake=wake)
        self.socket: socket.socket | None = None
        self.welcome = False
        self._went = False
        self._receiver: protocol.Receiver | None = None
        self._outgoing: deque[memoryview] = deque()

    @property
    def handshake(self) -> Mapping[str, Any]:
        """What the engine says of itself; empty before it did."""
        return self.process.handshake or {}

    @property
    def has_more_to_send(self) -> bool:
        """Whether the socket took less than there is."""
        return bool(self._outgoing)

    def connect(self) -> None:
        """Goes to where the engine listens, once that is known, and says the token."""
        if self._went or self.process.handshake is None:
            return
        self._went = True
        theirs = self.handshake.get("protocol")
        if theirs != protocol.PROTOCOL_VERSION:
            raise LostError("protocol", f"extension {protocol.PROTOCOL_VERSION}, engine {theirs}")
        try:
            address = ("127.0.0.1", int(self.handshake.get("port", 0)))
            self.socket = socket.create_connection(address, timeout=limits.WELCOME_S)
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.socket.setblocking(False)
        except (OSError, ValueError, TypeError, OverflowError) as error:
            raise self._break("broken_stream", str(error)) from error
        self._receiver = protocol.Receiver(self.socket)
        self.send([protocol.greeting(self.process.token)])

    def send(self, pieces: Iterable[bytes | memoryview]) -> None:
        """Sends as much as the socket takes now; `flush` the rest."""
        if self.socket is not None:
            self._outgoing.extend(memoryview(piece).cast("B") for piece in pieces)
            self.flush()

    def flush(self) -> None:
        """Sends as much of the rest as the socket takes."""
        try:
            while self._outgoing and self.socket is not None:
                sent = self.socket.send(self._outgoing[0])
                if sent < self._outgoing[0].nbytes:
                    self._outgoing[0] = self._outgoing[0][sent:]
                else:
                    self._outgoing.popleft()
        except (BlockingIOError, InterruptedError):
            return
        except OSError:  # the reading side says what is the matter
            self._outgoing.clear()

    def receive(self) -> protocol.Message | None:
        """The next message that has come whole, None when there is none. The first one is the engine's welcome."""
        if self._receiver is None:
            return None
        try:
            message = self._receiver.receive()
        except protocol.Disconnected as error:
            # an engine that does not know the token leaves without a word
            raise self._break("broken_stream" if self.welcome else "token", str(error)) from error
        except (protocol.ProtocolError, OSError) as error:
            self.disconnect()
            raise LostError("broken_stream", str(error)) from error
        if message is not None and not self.welcome:
            self._check_welcome(message)
        return message

    def why_it_ended(self) -> LostError | None:
        """The reason of the end of the process; None while it runs."""
        return None if self.process.runs else LostError(*self.process.why_it_ended())

    def disconnect(self) -> None:
        """Closes the socket."""
        if self.socket is not None:
            self.socket.close()
        self.socket = self._receiver = None
        self._outgoing.clear()

    def end(self) -> bool:
        """Ends what is left of process, socket and log; False when the process was killed and is still there."""
        self.disconnect()
        gone = self.process.kill()
        if not gone:
            self._log.write(f"process {self.process.popen.pid} was killed and is still there")
        self._log.end()
        return gone

    def _check_welcome(self, message: protocol.Message) -> None:
        if message.header.get("kind") != "welcome":
            refusal = told(message.header.get("error"))
            raise LostError(refusal.kind, refusal.detail)
        self.welcome = True

    def _break(self, kind: str, detail: str) -> LostError:
        """The connection broke; when that is because the process ends, that is the reason."""
        self.disconnect()
        if self.process.ends_within(limits.TERMINATE_S):
            return LostError(*self.process.why_it_ended())
        return LostError(kind, detail)
