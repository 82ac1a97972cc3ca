"""The renderer as a process: `python -m jghand_engine serve`.

The parent writes a token line to stdin; the first stdout line is the handshake as JSON. Everything later goes over a
socket on the loopback, and the end of stdin ends the process, whatever became of the parent. Source: BLENDER 3.1 to
3.4, RENDERING 13 (26).

Threads: the main thread answers requests one after the other; one reads the client's messages, so that it can cancel
what runs; one accepts connections and one each checks greetings; one sends the heart-beat; one watches stdin. All of
them sleep until something comes: an idle renderer uses no processor, and gives back the memory of its last image.
"""

from __future__ import annotations

import contextlib
import gc
import io
import json
import os
import queue
import selectors
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import IO, Any, NoReturn

from jghand_engine import __version__
from jghand_engine.errors import InputError
from jghand_engine.service import protocol
from jghand_engine.service.commands import Canceled, Commands, ImageSource, Reply, error_header
from jghand_engine.service.protocol import Disconnected, Message, ProtocolError
from jghand_engine.service.requests import Requests

# seconds between two signs of life; Blender calls the renderer slow after 5 s without one
HEARTBEAT_S = 1.0
# a stranger's time to say the token
GREETING_S = 2.0
# connections that the system keeps until they are accepted
BACKLOG = 8
# seconds without a request after which memory for images is given back: longer than between two frames of somebody who
# works, as the next one has to get it anew (some ms)
REST_AFTER_S = 5.0
# after the end of stdin a running request may finish for so long before the process ends regardless
STOP_GRACE_S = 3.0

LOOPBACK = "127.0.0.1"
# a request that is no request: the client does not want the answer to another one any more
CANCEL = "cancel"
# the pause after a connection that could not be accepted (no more file handles), seconds
_ACCEPT_REST_S = 0.2


def serve(source: ImageSource) -> NoReturn:
    """Runs the renderer until stdin ends or a client asks for the end, and then ends the process.

    stdout carries the handshake line and nothing else: whatever is printed afterwards goes to stderr.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C in the parent's terminal: the parent decides when we end
    handshake_out, parent = _take_stdout(), take_stdin()
    token = _read_token(parent)
    server = Server(source, token)
    threading.Thread(target=_end_with_stdin, args=(server, parent), daemon=True, name="stdin").start()
    with handshake_out:
        handshake_out.write(json.dumps(server.handshake()) + "\n")
    server.run()
    sys.stderr.flush()
    os._exit(0)  # nothing is left to be written


class Server:
    """Listens on a free port of the loopback and answers one client at a time."""

    def __init__(self, source: ImageSource, token: bytes) -> None:
        self._commands = Commands(source)
        self._token = token
        self._stop = threading.Event()
        self._clients: queue.Queue[socket.socket | None] = queue.Queue()  # None: the end
        self._client: socket.socket | None = None
        self._busy = threading.Lock()
        self._listener = socket.create_server((LOOPBACK, 0), backlog=BACKLOG)

    @property
    def port(self) -> int:
        """The port that the system chose."""
        return self._listener.getsockname()[1]

    def handshake(self) -> dict[str, Any]:
        """What the parent must know."""
        return {
            "protocol": protocol.PROTOCOL_VERSION,
            "port": self.port,
            "pid": os.getpid(),
            "engine_version": __version__,
            "capabilities": [*self._commands.capabilities, CANCEL],
        }

    def run(self) -> None:
        """Answers clients until `stop`."""
        threading.Thread(target=self._accept, daemon=True, name="accept").start()
        while not self._stop.is_set():
            client = self._clients.get()
            if client is not None:
                self._serve_client(client)
        self._listener.close()

    def stop(self) -> None:
        """Ends `run` from another thread, also while it waits for a message."""
        self._stop.set()
        self._clients.put(None)
        client = self._client
        for connection in (self._listener, client):
            if connection is not None:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def _accept(self) -> None:
        while not self._stop.is_set():
            try:
                connection, _ = self._listener.accept()
            except OSError:
                if self._stop.wait(_ACCEPT_REST_S):
                    return
                continue
            threading.Thread(target=self._greet, args=(connection,), daemon=True, name="greeting").start()

    def _greet(self, connection: socket.socket) -> None:
        """Lets a client in that knows the token; a stranger is cut off without an answer."""
        admitted = False
        try:
            deadline = time.monotonic() + GREETING_S
            version = protocol.receive_greeting(connection, self._token, deadline=deadline)
            if version is None:
                return
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            if version != protocol.PROTOCOL_VERSION:
                _refuse(connection, "protocol", f"The renderer speaks protocol {protocol.PROTOCOL_VERSION}.", deadline)
            elif not self._busy.acquire(blocking=False):
                _refuse(connection, "busy", "The renderer already has a client.", deadline)
            else:
                admitted = True
                self._clients.put(connection)
        except (OSError, Disconnected):
            return  # a stranger that says nothing, too little, or leaves; TimeoutError is an OSError
        finally:
            if not admitted:
                connection.close()

    def _serve_client(self, connection: socket.socket) -> None:
        """Answers one client until it leaves, breaks the protocol, or asks for the end."""
        self._client = connection
        requests, sending, gone = Requests(), threading.Lock(), threading.Event()
        signs = self._signs_of_life(requests)
        beat = threading.Thread(target=_beat, args=(connection, sending, gone, signs), daemon=True, name="heart-beat")
        read = threading.Thread(target=self._read, args=(connection, requests, sending), daemon=True, name="read")
        try:
            connection.settimeout(None)
            with sending:
                protocol.send(connection, {"kind": "welcome"})
            beat.start()
            read.start()
            while not self._stop.is_set():
                if not requests.come(REST_AFTER_S):
                    self._commands.source.rest()
                if not self._answer_next(connection, requests, sending):
                    break
        except Disconnected as error:
            self._tell(error)
        except OSError as error:
            _log(f"the client was cut off: {error}")
        finally:
            gone.set()
            self._client = None
            requests.end()
            with contextlib.suppress(OSError):  # wakes the thread that reads
                connection.shutdown(socket.SHUT_RDWR)
            connection.close()
            self._busy.release()

    def _answer_next(self, connection: socket.socket, requests: Requests, sending: threading.Lock) -> bool:
        """Answers one request; False when the client is gone. Nothing of it stays in memory: an idle renderer is
        small."""
        if (message := requests.take()) is None:
            return False
        header, reply = self._answer(message, requests.is_canceled)
        with sending:
            protocol.send(connection, header, reply.arrays)
        if reply.last:
            self._stop.set()
        return True

    def _signs_of_life(self, requests: Requests) -> Callable[[], list[dict[str, Any]]]:
        """What a heart-beat says: that the process lives, and what takes long just now."""

        def signs() -> list[dict[str, Any]]:
            doing, identity = self._commands.source.doing, requests.running_id
            tells = bool(doing) and type(identity) is int
            progress = {"kind": "progress", "id": identity, "fraction": None, "text": doing, "eta_s": None}
            return [{"kind": "heartbeat"}, *([progress] if tells else [])]

        return signs

    def _read(self, connection: socket.socket, requests: Requests, sending: threading.Lock) -> None:
        """Takes in a client's messages until it leaves or breaks the protocol."""
        try:
            kept = Message({})
            while True:
                message = protocol.receive(connection)
                if message.header.get("kind") == protocol.KEEP:
                    worlds = {name: array for name, array in message.arrays.items() if name == protocol.WORLD}
                    kept = replace(message, arrays=worlds)
                elif message.header.get("kind") != CANCEL:
                    knows = "kept" in message.header and message.header["kept"] == kept.header.get("key")
                    requests.put(replace(message, arrays=kept.arrays | message.arrays) if knows else message)
                elif requests.cancel(message.header.get("id")):
                    with sending:
                        protocol.send(connection, _failed(message, error_header(Canceled())))
        except Disconnected as error:
            self._tell(error)
        except (ProtocolError, OSError, ValueError) as error:  # ValueError: the other thread closed the connection
            if not self._stop.is_set() and connection.fileno() >= 0:
                _log(f"the client was cut off: {error}")
        finally:
            requests.end()

    def _tell(self, error: Disconnected) -> None:
        if not error.clean and not self._stop.is_set():
            _log(f"the client left: {error}")

    def _answer(self, message: Message, canceled: Callable[[], bool]) -> tuple[dict[str, Any], Reply]:
        """The reply to a request, with what it took here; every failure is a reply too."""
        begun = time.perf_counter()
        try:
            reply = self._commands.run(message, canceled)
            took_ms = round(1e3 * (time.perf_counter() - begun), 3)
            header = {**_to(message), "ok": True, "took_ms": took_ms, **reply.header}
            protocol.encode(header, reply.arrays)  # a reply that cannot be sent becomes an error that can
            return header, reply
        except Exception as error:  # whatever it is, the client hears of it and the renderer lives on
            failure = error_header(error)
        if failure["kind"] == "out_of_memory":
            gc.collect()
        return _failed(message, failure), Reply({}, {})


def _to(message: Message) -> dict[str, Any]:
    """What makes a reply the one to this request."""
    identity = message.header.get("id")
    return {"id": identity if type(identity) is int else None, "kind": "reply"}


def _failed(message: Message, failure: dict[str, str]) -> dict[str, Any]:
    return {**_to(message), "ok": False, "error": failure}


def _beat(
    connection: socket.socket,
    sending: threading.Lock,
    gone: threading.Event,
    signs: Callable[[], list[dict[str, Any]]],
) -> None:
    """Says once a second that the process lives; skipped while the client does not read."""
    while not gone.wait(HEARTBEAT_S):
        with sending:
            try:
                if not gone.is_set() and _takes_more(connection):
                    for sign in signs():
                        protocol.send(connection, sign)
            except (OSError, ValueError, Disconnected):
                return  # the connection is closed; whoever reads it notices


def _takes_more(connection: socket.socket) -> bool:
    """Whether something can be sent at once. Not by select.select, which knows only the first 1024 handles."""
    with selectors.DefaultSelector() as selector:
        selector.register(connection, selectors.EVENT_WRITE)
        return bool(selector.select(0))


def _refuse(connection: socket.socket, kind: str, sentence: str, deadline: float) -> None:
    error = {"kind": kind, "sentence": sentence, "detail": ""}
    protocol.send(connection, {"kind": "refused", "error": error}, deadline=deadline)


def take_stdin() -> int:
    """A handle of stdin for the parent's word alone; whoever else looks finds nothing there. On Windows a library that
    asks what stdin is waits for the thread that reads it: torch's and scipy's may, while they are loaded."""
    mine, nothing = os.dup(0), os.open(os.devnull, os.O_RDONLY)
    os.dup2(nothing, 0)
    os.close(nothing)
    return mine


def _take_stdout() -> IO[str]:
    """stdout for the handshake alone; what anything else prints afterwards goes to stderr, as long as it is read."""
    sys.stdout.flush()
    mine = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    sys.stdout = sys.stderr = io.TextIOWrapper(
        io.BufferedWriter(_Unbreakable()), encoding="utf-8", errors="replace", line_buffering=True
    )
    return mine


class _Unbreakable(io.RawIOBase):
    """stderr for people: a pipe that nobody reads any more makes no request fail."""

    def fileno(self) -> int:
        return 2

    def writable(self) -> bool:
        return True

    def write(self, content: Any, /) -> int:
        left = memoryview(content)
        with contextlib.suppress(OSError):
            while left:
                left = left[os.write(2, left) :]
        return memoryview(content).nbytes


def _read_token(parent: int) -> bytes:
    """The token from the parent's first line: hexadecimal. Read by os.read, so that nothing of it is in a buffer."""
    wanted = protocol.TOKEN_BYTES * 2
    line = b""
    while not line.endswith(b"\n") and len(line) <= wanted + 2:
        byte = os.read(parent, 1)
        if not byte:
            break
        line += byte
    try:
        token = bytes.fromhex(line.decode("ascii").strip())
    except ValueError:
        token = b""
    if len(token) != protocol.TOKEN_BYTES:
        raise InputError(
            "token on stdin",
            wanted=f"one line of {wanted} hexadecimal digits",
            came=f"{len(line)} bytes",
            remedy="This command is started by Blender, not by hand.",
        )
    return token


def _end_with_stdin(server: Server, parent: int) -> None:
    """Waits for the end of stdin, which is the end of the parent; then ends the process, gently and then for sure."""
    try:
        while os.read(parent, 4096):
            pass
    except OSError as error:
        _log(f"stdin cannot be read: {error}")
    server.stop()
    time.sleep(STOP_GRACE_S)
    os._exit(0)


def _log(sentence: str) -> None:
    print(f"jghand renderer: {sentence}", file=sys.stderr, flush=True)
