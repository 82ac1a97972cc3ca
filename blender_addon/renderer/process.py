# SPDX-License-Identifier: GPL-3.0-or-later
"""One engine: where it is, its process, what it prints, and the socket to it. Does not use bpy.

It is the Python that was chosen, the engine that the extension carries, or the one of a checkout. Drawing, motions and
exports need nothing but what the extension carries. Training, tracking and captures need PyTorch and more: the training
tools (install_tools.py), or an environment of the user's that has it all. The engine ends when its stdin does, so it
cannot outlive this process, however that ends. Source: BLENDER 3.1, 3.2 and 3.4.
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import secrets
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import IO, Any

from ..core import protocol
from ..errors import EXIT_KINDS, JGHandFailure
from . import state as machine
from .waiting import failure_told

VARIABLE = "JGHAND_ENGINE_PYTHON"
# what the extension's zip carries beside its own modules; a checkout does not
CARRIED = Path(__file__).resolve().parents[1] / "engine"
_INTERPRETERS = ("bin/python", "bin/python3", "Scripts/python.exe", "python.exe")
# in Blender's own Python: what the engine needs beside Blender's numpy lies in the folders that are its first words
_RUN_CARRIED = (
    "import sys; sys.path[:0] = sys.argv[1:3]; del sys.argv[1:3]; from jghand_engine.cli import main; sys.exit(main())"
)
_SYSTEMS = {"linux": "linux", "darwin": "macos", "win32": "windows"}
_MACHINES = {"x86_64": "x86_64", "amd64": "x86_64", "aarch64": "aarch64", "arm64": "aarch64"}


def engine_command(python: str | None = None, *, on_gpu: bool = False, **places: Any) -> tuple[str, ...]:
    """The command that starts the engine as a service. on_gpu: one that draws on the graphics card, and refuses to
    start without one; places: as of `engine_program`."""
    words = (*engine_program(python, **places), "serve")
    return (*words, "--backend", "gpu") if on_gpu else words


def engine_program(
    python: str | None = None,
    *,
    checkout: Path | None = None,
    tools: Path | None = None,
    learns: bool = False,
    environment: Mapping[str, str] = os.environ,
) -> tuple[str, ...]:
    """The words before a verb of the engine's command line. The first that is given wins; a given one that does not
    exist is a failure.

    python: path of an interpreter that has jghand installed; then the variable JGHAND_ENGINE_PYTHON; then the engine
    that the extension carries; then `checkout`/.envs/engine.
    learns: for what needs PyTorch: `tools`, the interpreter of the training tools, stands in place of what is carried.
    Raises JGHandFailure: no_python or no_named_python for a given one, no_interpreter, or no_tools where only those are
    missing.
    """
    for missing, path in (("no_python", python), ("no_named_python", environment.get(VARIABLE))):
        if path:
            chosen = _interpreter_at(path)
            if not os.path.isfile(chosen):
                raise JGHandFailure(missing, path)
            return _by_python(chosen)
    if learns and tools is not None:
        return _by_python(tools)
    carried = (CARRIED / "common").is_dir()
    if carried and not learns:
        machine = platform.machine().lower()
        here = f"{_SYSTEMS.get(sys.platform, sys.platform)}_{_MACHINES.get(machine, machine)}"
        return sys.executable, "-I", "-c", _RUN_CARRIED, str(CARRIED / here), str(CARRIED / "common")
    if checkout is not None:
        made = _interpreter_at(str(checkout / ".envs" / "engine"))
        if os.path.isfile(made):
            return _by_python(made)
    if carried:
        raise JGHandFailure("no_tools")
    raise JGHandFailure("no_interpreter", "this is a checkout that was not installed: run scripts/demo.py once")


def _interpreter_at(text: str) -> Path:
    """The interpreter that somebody means who chose `text`: a path, perhaps in quotation marks as it was copied, or the
    folder of an environment."""
    path = Path(text.strip().strip("\"'")).expanduser()
    return next((path / name for name in _INTERPRETERS if os.path.isfile(path / name)), path)


def _by_python(path: Path) -> tuple[str, ...]:
    return str(path), "-I", "-m", "jghand_engine"


# ---- the process -----------------------------------------------------------------------------------------------------

# no window of a console flashes up on Windows; the other systems have none
HIDDEN = getattr(subprocess, "CREATE_NO_WINDOW", 0)
# what Blender's own process would impose on another Python
_DROPPED = ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "LD_LIBRARY_PATH", "LD_PRELOAD", "OCIO")
_DROPPED_PREFIXES = ("DYLD_", "BLENDER_")
# to a port of this machine: longer means that something is in between
_CONNECT_S = 5.0
# bytes of one line: a handshake, or progress
_LINE_MAX = 65536
# after the end of the process, what it printed last may still be on its way
_LAST_WORDS_S = 0.2


def cleaned_environment(environment: Mapping[str, str]) -> dict[str, str]:
    """The environment for a Python that is not Blender's. It says where `jghand capture` finds this extension."""
    kept = {
        name: value
        for name, value in environment.items()
        if name not in _DROPPED and not name.startswith(_DROPPED_PREFIXES)
    }
    return kept | {"JGHAND_BLENDER_ADDON": str(Path(__file__).resolve().parents[1])}


class Child:
    """A process whose standard input means that it is wanted, and whose lines are heard as they come.

    Nothing waits here but `ends_within`."""

    def __init__(self, command: Sequence[str], heard: Callable[[str, bool], None], ended: Callable[[], None]) -> None:
        """heard: gets each line, and whether it is of the standard output; ended: called when there are no more of one
        of both; from other threads. JGHandFailure: no_interpreter."""
        try:
            self.popen = subprocess.Popen(
                list(command),
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                env=cleaned_environment(os.environ),
                creationflags=HIDDEN,
                # a Ctrl-C in Blender's terminal is Blender's, and all that a process starts ends with it
                start_new_session=os.name != "nt",
            )
        except OSError as error:
            raise JGHandFailure("no_interpreter", f"{command[0]}: {error.strerror or error}") from error
        self._readers = [
            threading.Thread(target=self._read, args=(pipe, heard, ended), daemon=True, name="jghand lines")
            for pipe in (self.popen.stdout, self.popen.stderr)
        ]
        for reader in self._readers:
            reader.start()

    def close_stdin(self) -> None:
        if self.popen.stdin is not None:
            with contextlib.suppress(OSError):
                self.popen.stdin.close()

    def said_all(self, wait_s: float = 0.0) -> bool:
        """Whether what an ended process printed last is here: a process that it left behind may hold its pipes open."""
        for reader in self._readers if wait_s else ():
            reader.join(wait_s)
        return not any(reader.is_alive() for reader in self._readers)

    def ends_within(self, seconds: float) -> bool:
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.popen.wait(seconds)
        return self.popen.poll() is not None

    def end_tree(self, *, at_once: bool) -> None:
        """Ends it and those that it started. at_once: without asking; Windows has no other way."""
        if sys.platform != "win32":
            with contextlib.suppress(OSError):
                os.killpg(self.popen.pid, signal.SIGKILL if at_once else signal.SIGTERM)
            return
        system = os.environ.get("SYSTEMROOT", r"C:\Windows")
        words = [rf"{system}\System32\taskkill.exe", "/F", "/T", "/PID", str(self.popen.pid)]
        with contextlib.suppress(OSError, subprocess.TimeoutExpired):
            subprocess.run(
                words,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                creationflags=HIDDEN,
                timeout=machine.KILL_S,
                check=False,
            )
        with contextlib.suppress(OSError):
            self.popen.kill()  # where that has failed

    def _read(self, pipe: IO[bytes], heard: Callable[[str, bool], None], ended: Callable[[], None]) -> None:
        """Keeps a pipe from filling up."""
        with pipe:
            for raw in iter(lambda: pipe.readline(_LINE_MAX), b""):
                heard(raw.decode("utf-8", "replace").rstrip(), pipe is self.popen.stdout)
        ended()


class EngineProcess(Child):
    """An engine that was started; `connect` when it has said where it listens; then messages. JGHandFailure: it cannot
    be used any more.

    Only `kill` and the search for the reason of a break wait, and not for long."""

    def __init__(self, command: Sequence[str], log: deque[str], wake: Callable[[], None]) -> None:
        """log: gets the lines that it prints. wake: called from another thread when there is something to look at.

        JGHandFailure: no_interpreter."""
        self.token = secrets.token_bytes(protocol.TOKEN_BYTES)
        # what the engine says of itself, once it does
        self.handshake: Mapping[str, Any] = {}
        self.socket: socket.socket | None = None
        self._greeted = self._welcome = False
        self._receiver: protocol.Receiver | None = None
        # what the socket has not taken yet
        self.outgoing: deque[memoryview] = deque()
        # the key of what it keeps
        self.kept = ""
        self._log, self._wake = log, wake
        super().__init__(command, self._hear, wake)
        assert self.popen.stdin is not None  # it was asked for as a pipe
        with contextlib.suppress(OSError):  # it has ended already, which `why_it_ended` tells
            self.popen.stdin.write(self.token.hex().encode() + b"\n")
            self.popen.stdin.flush()

    # ---- messages ----------------------------------------------------------------------------------------------------

    def connect(self) -> None:
        """Connects to where the engine listens, once that is known, and says the token."""
        if self._greeted or not self.handshake:
            return
        self._greeted = True
        theirs = self.handshake["protocol"]
        if theirs != protocol.PROTOCOL_VERSION:
            raise JGHandFailure("protocol", f"extension {protocol.PROTOCOL_VERSION}, engine {theirs}")
        try:
            address = ("127.0.0.1", int(self.handshake.get("port", 0)))
            self.socket = socket.create_connection(address, timeout=_CONNECT_S)
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self.socket.setblocking(False)
        except (OSError, ValueError, TypeError, OverflowError) as error:
            raise self._broken("broken_stream", str(error)) from error
        self._receiver = protocol.Receiver(self.socket)
        self.send([protocol.greeting(self.token)])

    def send(self, pieces: Iterable[bytes | memoryview]) -> None:
        """Sends as much as the socket takes now, of what is left from before first."""
        self.outgoing.extend(memoryview(piece).cast("B") for piece in pieces)
        try:
            while self.outgoing and self.socket is not None:
                sent = self.socket.send(self.outgoing[0])
                if sent < self.outgoing[0].nbytes:
                    self.outgoing[0] = self.outgoing[0][sent:]
                else:
                    self.outgoing.popleft()
        except (BlockingIOError, InterruptedError):
            return
        except OSError:  # the reading side says what is the matter
            self.outgoing.clear()

    def receive(self) -> protocol.Message | None:
        """The next message that has come whole, None when there is none. The first one is the engine's welcome."""
        if self._receiver is None:
            return None
        try:
            message = self._receiver.receive()
        except protocol.Disconnected as error:
            # an engine that does not know the token leaves without a word
            raise self._broken("broken_stream" if self._welcome else "token", str(error)) from error
        except (protocol.ProtocolError, OSError) as error:
            self._disconnect()
            raise JGHandFailure("broken_stream", str(error)) from error
        if message is not None and not self._welcome:
            if message.header.get("kind") != "welcome":
                raise failure_told(message.header.get("error"))
            self._welcome = True
        return message

    # ---- the end -----------------------------------------------------------------------------------------------------

    def why_it_ended(self) -> JGHandFailure | None:
        """The reason of the end of the process; None while it runs."""
        code = self.popen.poll()
        if code is None:
            return None
        self.said_all(_LAST_WORDS_S)
        missing = [line for line in tuple(self._log) if "No module named" in line]
        if not self.handshake and missing:
            return JGHandFailure("no_engine", missing[-1].strip())
        return JGHandFailure(EXIT_KINDS.get(code, "crashed"), f"exit code {code}")

    def kill(self) -> None:
        self._disconnect()
        with contextlib.suppress(OSError):
            self.popen.kill()
        self.ends_within(machine.KILL_S)
        self.close_stdin()

    def _disconnect(self) -> None:
        if self.socket is not None:
            self.socket.close()
        self.socket = self._receiver = None
        self.outgoing.clear()

    def _broken(self, kind: str, detail: str) -> JGHandFailure:
        """The connection broke; when that is because the process ends, a little later, that is the reason."""
        self._disconnect()
        ended = self.why_it_ended() if self.ends_within(machine.TERMINATE_S) else None
        return ended or JGHandFailure(kind, detail)

    def _hear(self, line: str, is_output: bool) -> None:
        """Finds the handshake in what it prints."""
        found = told_in(line) if not self.handshake and is_output else {}
        if "protocol" in found:
            self.handshake = found
            self._wake()
        elif line:
            self._log.append(line[: machine.LOG_LINE_MAX])


def told_in(line: str) -> dict[str, Any]:
    """The JSON object that a line is; empty for any other line."""
    try:
        content = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return content if isinstance(content, dict) else {}
