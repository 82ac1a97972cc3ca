"""The messages between Blender and the engine. Standard library only: Blender's Python imports this very file.

A message is a u32 little-endian header length, a UTF-8 JSON header, and the raw little-endian arrays in the order in
which the header lists them under "arrays" as {"name", "dtype", "shape"}. Lengths are checked before anything is
allocated. The first bytes that a client sends are not a message but its greeting: the token and the protocol version.

Source: BLENDER 3.1 and 3.2, RENDERING 13 (26).
"""

from __future__ import annotations

import hmac
import json
import math
import socket
import struct
import sys
import time
from collections.abc import Generator, Mapping
from dataclasses import dataclass, field
from typing import Any

# compared with strict equality on both sides; raise it with every change of a message
PROTOCOL_VERSION = 5
# the header is names, numbers and a FrameReport: 64 kB is plenty and bounds the work on hostile JSON
HEADER_MAX_BYTES = 64 * 1024
# a 16 K x 4 K float picture; bounds what one message can make the other side allocate
PAYLOAD_MAX_BYTES = 1 << 30
ARRAYS_MAX = 64
DIMENSIONS_MAX = 4
NAME_MAX = 64
# random bytes of the token: beyond guessing, whoever may connect
TOKEN_BYTES = 32
# dtype on the wire (numpy's spelling) -> (bytes per element, format letter of the struct module)
DTYPES = {"|u1": (1, "B"), "<i4": (4, "i"), "<i8": (8, "q"), "<f4": (4, "f"), "<f8": (8, "d")}
# format letters under which the same types come out of numpy's and array's buffers
_DTYPE_OF_FORMAT = {"B": "|u1", "i": "<i4", "q": "<i8", "l": f"<i{struct.calcsize('l')}", "f": "<f4", "d": "<f8"}

# a message without a reply, and its array: the engine keeps it until the next one, and gives it to each request whose
# header has its `key` as `kept`
KEEP, WORLD = "keep", "world"

_LENGTH = struct.Struct("<I")
_GREETING = struct.Struct(f"<{TOKEN_BYTES}sI")
GREETING_BYTES = _GREETING.size


class ProtocolError(Exception):
    """What came is not a message of this protocol; the stream cannot be trusted any further."""


class Disconnected(Exception):  # noqa: N818 - not an error: the other side may leave
    """The other side closed the connection (cleanly between two messages when `clean`)."""

    def __init__(self, sentence: str, *, clean: bool = False) -> None:
        super().__init__(sentence)
        self.clean = clean


@dataclass(frozen=True)
class Array:
    """One array of a message. dtype: a key of DTYPES; shape: 1 to 4 sizes >= 1; data: its bytes, C order."""

    dtype: str
    shape: tuple[int, ...]
    data: memoryview

    @classmethod
    def of(cls, buffer: Any) -> Array:
        """From anything with a typed C-contiguous buffer: a numpy array, array.array, bytes. Nothing is copied."""
        view = memoryview(buffer)
        shape = view.shape or ()
        dtype = _DTYPE_OF_FORMAT.get(view.format.lstrip("<=@"))
        if dtype not in DTYPES:
            raise ProtocolError(f"an array of type {view.format!r} cannot be sent; allowed are {', '.join(DTYPES)}")
        if not 1 <= view.ndim <= DIMENSIONS_MAX or 0 in shape or not view.c_contiguous:
            raise ProtocolError(f"an array of shape {shape} cannot be sent: 1 to 4 sizes from 1, C order")
        return cls(dtype, tuple(shape), view.cast("B"))

    def view(self) -> memoryview:
        """The values with their type and shape; `numpy.asarray(array.view())` copies nothing."""
        letter: Any = DTYPES[self.dtype][1]
        return self.data.cast("B").cast(letter, self.shape)


@dataclass(frozen=True)
class Message:
    """header: JSON object, without the "arrays" entry; arrays: by name."""

    header: dict[str, Any]
    arrays: dict[str, Array] = field(default_factory=dict)


def encode(header: Mapping[str, Any], arrays: Mapping[str, Array] | None = None) -> list[bytes | memoryview]:
    """The pieces of a message, to be sent one after the other; ProtocolError when it exceeds a limit or is no JSON."""
    _refuse_big_endian()
    arrays = arrays or {}
    entries = [{"name": name, "dtype": a.dtype, "shape": list(a.shape)} for name, a in arrays.items()]
    try:
        text = json.dumps({**header, "arrays": entries}, separators=(",", ":"), allow_nan=False).encode()
    except (TypeError, ValueError) as error:  # NaN, infinity, a number of numpy's
        raise ProtocolError(f"the header cannot be sent as JSON: {error}") from error
    if len(text) > HEADER_MAX_BYTES:
        raise ProtocolError(f"the header has {len(text)} bytes; {HEADER_MAX_BYTES} are allowed")
    sizes = [size for _, _, _, size in _array_entries(entries)]
    if any(size != a.data.nbytes for size, a in zip(sizes, arrays.values(), strict=True)):
        raise ProtocolError("an array's bytes do not fit its shape")
    return [_LENGTH.pack(len(text)) + text, *(a.data for a in arrays.values())]


def send(
    connection: socket.socket,
    header: Mapping[str, Any],
    arrays: Mapping[str, Array] | None = None,
    *,
    deadline: float | None = None,
) -> None:
    """Sends one message whole. The caller keeps two threads from sending at once.

    `deadline` on the clock of time.monotonic(); None keeps the connection's own timeout. Raises TimeoutError,
    Disconnected, or ProtocolError before anything was sent.
    """
    for piece in encode(header, arrays):
        if deadline is not None:
            connection.settimeout(_seconds_left(deadline))
        try:
            connection.sendall(piece)
        except ConnectionError as error:
            raise Disconnected(f"the connection broke: {error}") from error


def receive(connection: socket.socket, *, deadline: float | None = None) -> Message:
    """Reads one message. `deadline` on the clock of time.monotonic(); None waits for ever.

    Raises TimeoutError, Disconnected, or ProtocolError before it has allocated anything that the limits forbid.
    """
    message, between_messages = _reading(), True
    try:
        while True:
            _fill(next(message), connection, deadline, between_messages=between_messages)
            between_messages = False
    except StopIteration as whole:
        return whole.value


class Receiver:
    """Reads messages from a connection that does not block, as far as they have come."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._begin()

    def receive(self) -> Message | None:
        """The next whole message, None while it is on its way. Raises Disconnected or ProtocolError."""
        while True:
            try:
                step = self._connection.recv_into(self._missing)
            except (BlockingIOError, InterruptedError):
                return None
            except ConnectionError as error:
                raise Disconnected(f"the connection broke: {error}") from error
            if step == 0:
                raise Disconnected("the other side closed the connection", clean=self._clean)
            self._clean = False
            self._missing = self._missing[step:]
            if not self._missing:
                try:
                    self._missing = memoryview(next(self._message))
                except StopIteration as whole:
                    self._begin()
                    return whole.value

    def _begin(self) -> None:
        self._message, self._clean = _reading(), True
        self._missing = memoryview(next(self._message))


def _reading() -> Generator[bytearray, None, Message]:
    """Reads one message: yields buffers to be filled one after the other, and returns the message."""
    _refuse_big_endian()
    prefix = bytearray(_LENGTH.size)
    yield prefix
    (length,) = _LENGTH.unpack(prefix)
    if not 2 <= length <= HEADER_MAX_BYTES:
        raise ProtocolError(f"a header of {length} bytes; 2 to {HEADER_MAX_BYTES} are allowed")
    text = bytearray(length)
    yield text
    header = _parse_header(text)
    arrays = {}
    for name, dtype, shape, size in _array_entries(header.pop("arrays", [])):
        content = bytearray(size)
        yield content
        arrays[name] = Array(dtype, shape, memoryview(content))
    return Message(header, arrays)


def greeting(token: bytes) -> bytes:
    """What a client sends first: the token and its protocol version."""
    return _GREETING.pack(token, PROTOCOL_VERSION)


def receive_greeting(connection: socket.socket, token: bytes, *, deadline: float) -> int | None:
    """The version of a client that knows the token, None for one that does not.

    The token is compared in constant time, and nothing else of a stranger is looked at.
    """
    content = bytearray(GREETING_BYTES)
    _fill(content, connection, deadline, between_messages=True)
    came, version = _GREETING.unpack(content)
    return version if hmac.compare_digest(came, token) else None


def _fill(buffer: bytearray, connection: socket.socket, deadline: float | None, *, between_messages: bool) -> None:
    """Fills the buffer whole, or Disconnected; `deadline` bounds the whole wait, not each piece of it."""
    view, got = memoryview(buffer), 0
    while got < len(buffer):
        connection.settimeout(_seconds_left(deadline))
        try:
            step = connection.recv_into(view[got:])
        except ConnectionError as error:
            raise Disconnected(f"the connection broke: {error}") from error
        if step == 0:
            raise Disconnected("the other side closed the connection", clean=between_messages and got == 0)
        got += step


def _seconds_left(deadline: float | None) -> float | None:
    if deadline is None:
        return None
    left = deadline - time.monotonic()
    if left <= 0:
        raise TimeoutError("no message in time")
    return left


def _parse_header(text: bytearray) -> dict[str, Any]:
    try:
        header = json.loads(text.decode("utf-8"), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise ProtocolError(f"the header is not JSON: {error}") from error
    if not isinstance(header, dict):
        raise ProtocolError(f"the header is a {type(header).__name__}, not an object")
    return header


def _refuse_constant(name: str) -> float:
    raise ValueError(f"{name} is not JSON")


def _array_entries(entries: Any) -> list[tuple[str, str, tuple[int, ...], int]]:
    """(name, dtype, shape, bytes) of every array that a header announces, all checked against the limits."""
    if not isinstance(entries, list) or len(entries) > ARRAYS_MAX:
        raise ProtocolError(f"the list of arrays is not a list of at most {ARRAYS_MAX}")
    result = []
    for entry in entries:
        if not isinstance(entry, dict) or set(entry) != {"name", "dtype", "shape"}:
            raise ProtocolError("an array is announced by name, dtype and shape and nothing else")
        name, dtype, shape = entry["name"], entry["dtype"], entry["shape"]
        if not isinstance(name, str) or not 1 <= len(name) <= NAME_MAX:
            raise ProtocolError(f"an array's name has 1 to {NAME_MAX} letters")
        if not isinstance(dtype, str) or dtype not in DTYPES:
            raise ProtocolError(f"array {name!r}: type {str(dtype)[:NAME_MAX]!r}; allowed are {', '.join(DTYPES)}")
        if not _good_shape(shape):
            raise ProtocolError(f"array {name!r}: its shape is not 1 to {DIMENSIONS_MAX} whole numbers from 1")
        result.append((name, dtype, tuple(shape), math.prod(shape) * DTYPES[dtype][0]))
    if len({name for name, *_ in result}) != len(result):
        raise ProtocolError("two arrays have the same name")
    total = sum(size for *_, size in result)
    if total > PAYLOAD_MAX_BYTES:
        raise ProtocolError(f"the arrays have {total} bytes; {PAYLOAD_MAX_BYTES} are allowed")
    return result


def _good_shape(shape: Any) -> bool:
    return (
        isinstance(shape, list)
        and 1 <= len(shape) <= DIMENSIONS_MAX
        and all(type(size) is int and 1 <= size <= PAYLOAD_MAX_BYTES for size in shape)
    )


def _refuse_big_endian() -> None:
    if sys.byteorder != "little":
        raise ProtocolError("this machine is big-endian; the arrays on the wire are little-endian")
