# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine as a child process: start, handshake, requests with a time limit, a clean end. Does not use bpy.

Every wait has a time limit and looks whether the process still lives. The engine ends when its stdin does, so it
cannot outlive this process, however that ends. Source: BLENDER 3.1 and 3.4.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import secrets
import select
import socket
import subprocess
import threading
import time
from collections import deque
from collections.abc import Mapping, Sequence
from typing import IO, Any

from . import limits
from .messages import JGHandFailure
from .wire import protocol

# what Blender's own process would impose on another Python
_DROPPED = ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "LD_LIBRARY_PATH", "LD_PRELOAD", "OCIO")
_DROPPED_PREFIXES = ("DYLD_", "BLENDER_")


def cleaned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment for a Python that is not Blender's."""
    return {
        name: value
        for name, value in environment.items()
        if name not in _DROPPED and not name.startswith(_DROPPED_PREFIXES)
    }


class EngineClient:
    """A running engine. `with EngineClient.start(command) as engine: engine.request({...})`."""

    def __init__(self, process: subprocess.Popen[bytes]) -> None:
        self._process = process
        self._output: deque[str] = deque(maxlen=limits.LOG_LINES)
        self._lines: queue.Queue[str] = queue.Queue(maxsize=1)
        self._connection: socket.socket | None = None
        self._next_id = 1
        self._last_heard = time.monotonic()
        self.handshake: dict[str, Any] = {}
        for pipe, look in ((process.stdout, True), (process.stderr, False)):
            threading.Thread(target=self._drain, args=(pipe, look), daemon=True, name="jghand log").start()

    @classmethod
    def start(
        cls,
        command: Sequence[str],
        *,
        environment: Mapping[str, str] = os.environ,
        timeout_s: float = limits.HANDSHAKE_S,
    ) -> EngineClient:
        """Starts the engine and greets it; JGHandFailure says why that failed, and nothing is left running."""
        try:
            process = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=cleaned_environment(environment),
                creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
            )
        except OSError as error:
            raise JGHandFailure("no_interpreter", f"{command[0]}: {error.strerror or error}") from error
        engine = cls(process)
        try:
            engine._greet(time.monotonic() + timeout_s)
        except BaseException:
            engine.kill()
            raise
        return engine

    @property
    def alive(self) -> bool:
        """True while the process runs and the connection stands."""
        return self._process.poll() is None and self._connection is not None

    @property
    def log(self) -> str:
        """The last lines that the engine printed."""
        return "\n".join(self._output)

    def request(
        self,
        header: Mapping[str, Any],
        arrays: Mapping[str, protocol.Array] | None = None,
        *,
        timeout_s: float = limits.REQUEST_S,
    ) -> protocol.Message:
        """Sends a request and waits for its reply.

        Raises JGHandFailure: bad_input for what cannot be sent, the engine's own kind when it answers with an error
        (it lives on in both cases), else crashed, killed, out_of_memory, hung or broken_stream (it is ended).
        """
        if self._connection is None:
            raise JGHandFailure("crashed", "the engine is not running")
        connection = self._connection
        identity, self._next_id = self._next_id, self._next_id + 1
        try:
            protocol.encode({**header, "id": identity}, arrays)
        except protocol.ProtocolError as error:
            raise JGHandFailure("bad_input", str(error)) from error
        deadline = time.monotonic() + timeout_s
        self._last_heard = time.monotonic()  # heart-beats from before are still unread
        try:
            protocol.send(connection, {**header, "id": identity}, arrays, deadline=deadline)
            reply = self._receive(connection, deadline)
            while reply.header.get("id") != identity:
                reply = self._receive(connection, deadline)
        except (protocol.Disconnected, protocol.ProtocolError, OSError) as error:
            raise self._lost(error) from error
        if not reply.header.get("ok"):
            raise self._told(reply.header.get("error"))
        return reply

    def close(self) -> None:
        """Ends the engine: by the end of its stdin, then by asking, then by force. May be called twice."""
        self._disconnect()
        if self._process.stdin:
            with contextlib.suppress(OSError):
                self._process.stdin.close()
        for patience, stronger in ((limits.STOP_S, self._process.terminate), (limits.TERMINATE_S, self._process.kill)):
            try:
                self._process.wait(patience)
                return
            except subprocess.TimeoutExpired:
                stronger()
        self._process.wait()

    def kill(self) -> None:
        """Ends the engine at once."""
        self._disconnect()
        self._process.kill()
        self._process.wait()
        if self._process.stdin:
            with contextlib.suppress(OSError):
                self._process.stdin.close()

    def __enter__(self) -> EngineClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    # ---- start -------------------------------------------------------------------------------------------------------

    def _greet(self, deadline: float) -> None:
        token = secrets.token_bytes(protocol.TOKEN_BYTES)
        try:
            assert self._process.stdin is not None  # it was asked for as a pipe
            self._process.stdin.write(token.hex().encode() + b"\n")
            self._process.stdin.flush()
        except OSError as error:
            raise self._ended() from error
        self.handshake = self._await_handshake(deadline)
        if self.handshake.get("protocol") != protocol.PROTOCOL_VERSION:
            theirs = self.handshake.get("protocol")
            raise JGHandFailure("protocol", f"extension {protocol.PROTOCOL_VERSION}, engine {theirs}")
        deadline = time.monotonic() + limits.WELCOME_S
        try:
            address = ("127.0.0.1", int(self.handshake.get("port", 0)))
            self._connection = socket.create_connection(address, timeout=limits.WELCOME_S)
            self._connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connection.sendall(protocol.greeting(token))
            welcome = protocol.receive(self._connection, deadline=deadline)
        except (protocol.Disconnected, protocol.ProtocolError, OSError, ValueError, TypeError) as error:
            if self._ends():
                raise self._ended() from error
            # an engine that does not know the token leaves without a word
            kind = "token" if isinstance(error, protocol.Disconnected) else "broken_stream"
            raise self._failure(kind, str(error)) from error
        if welcome.header.get("kind") != "welcome":
            raise self._told(welcome.header.get("error"))

    def _await_handshake(self, deadline: float) -> dict[str, Any]:
        while time.monotonic() < deadline:
            with contextlib.suppress(queue.Empty):
                return json.loads(self._lines.get(timeout=limits.POLL_S))
            if self._process.poll() is not None and self._lines.empty():
                raise self._ended()
        raise self._failure("start_timeout")

    def _drain(self, pipe: IO[bytes], look_for_handshake: bool) -> None:
        """Keeps a pipe of the engine from filling up; remembers its last lines; finds the handshake in stdout."""
        with pipe:
            for raw in iter(lambda: pipe.readline(limits.LOG_LINE_MAX), b""):
                line = raw.decode("utf-8", "replace").rstrip()
                if look_for_handshake and _is_handshake(line):
                    self._lines.put(line)
                    look_for_handshake = False
                elif line:
                    self._output.append(line)

    # ---- messages ----------------------------------------------------------------------------------------------------

    def _receive(self, connection: socket.socket, deadline: float) -> protocol.Message:
        """The next message that is not a heart-beat."""
        while True:
            self._await_bytes(connection, deadline)
            message = protocol.receive(connection, deadline=deadline)
            self._last_heard = time.monotonic()
            if message.header.get("kind") != "heartbeat":
                return message

    def _await_bytes(self, connection: socket.socket, deadline: float) -> None:
        """Waits until something can be read; the death of the process shows as the end of the connection."""
        while not select.select([connection], [], [], limits.POLL_S)[0]:
            now = time.monotonic()
            if now > deadline:
                raise TimeoutError("no reply in time")
            if now - self._last_heard > limits.SILENCE_S:
                raise TimeoutError("no sign of life")
            if self._process.poll() is not None:
                raise protocol.Disconnected("the process ended")

    # ---- failures ----------------------------------------------------------------------------------------------------

    def _lost(self, error: Exception) -> JGHandFailure:
        """The failure behind a broken exchange; the engine is ended, since the stream cannot be trusted."""
        if self._ends():
            failure = self._ended()
        else:
            failure = self._failure("hung" if isinstance(error, TimeoutError) else "broken_stream", str(error))
        self.kill()
        return failure

    def _ends(self) -> bool:
        """Whether the process has ended or is about to: a connection breaks a little before its process is gone."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(limits.TERMINATE_S)
        return self._process.poll() is not None

    def _ended(self) -> JGHandFailure:
        """The failure behind the end of the process."""
        time.sleep(limits.POLL_S)  # its last words may still be on their way
        code, log = self._process.poll(), self.log
        if "No module named" in log and "jghand_engine" in log:
            return self._failure("no_engine")
        if code in (-9, 137):
            return self._failure("killed")
        if code == 4:
            return self._failure("out_of_memory")
        return self._failure("crashed", f"exit code {code}")

    def _told(self, error: Any) -> JGHandFailure:
        """The failure that the engine reports; its own sentence is the detail."""
        if not isinstance(error, dict):
            return self._failure("broken_stream", "an error without a description")
        detail = "\n".join(str(error[key]) for key in ("sentence", "detail") if error.get(key))
        return JGHandFailure(str(error.get("kind")), detail, log=self.log)

    def _failure(self, kind: str, what: str = "") -> JGHandFailure:
        """A failure of the engine, with the last lines that it printed as the detail."""
        last = list(self._output)[-limits.DETAIL_LINES :]
        return JGHandFailure(kind, "\n".join([what, *last] if what else last), log=self.log)

    def _disconnect(self) -> None:
        if self._connection is not None:
            self._connection.close()
            self._connection = None


def _is_handshake(line: str) -> bool:
    try:
        content = json.loads(line)
    except ValueError:
        return False
    return isinstance(content, dict) and "protocol" in content
