"""Messages survive the journey; what is no message is refused before anything is allocated for it."""

import json
import socket
import struct
import threading
import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from jghand_engine.service import protocol
from jghand_engine.service.protocol import Array, Disconnected, ProtocolError


@pytest.fixture
def pair():
    left, right = socket.socketpair()
    with left, right:
        yield left, right


def received(content: bytes) -> protocol.Message:
    """What `receive` makes of raw bytes after which the other side leaves."""
    left, right = socket.socketpair()
    with left, right:
        sender = threading.Thread(target=_send_and_leave, args=(left, content))
        sender.start()
        try:
            return protocol.receive(right, deadline=time.monotonic() + 5)
        finally:
            right.close()
            sender.join()


def _send_and_leave(connection: socket.socket, content: bytes) -> None:
    try:
        connection.sendall(content)
        connection.shutdown(socket.SHUT_WR)
    except OSError:
        pass  # the reader refused early and left


def framed(header: object) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<I", len(text)) + text


def announcing(**entry: object) -> bytes:
    return framed({"arrays": [{"name": "a", "dtype": "<f4", "shape": [2], **entry}]})


@given(
    st.dictionaries(st.text(max_size=8).filter(lambda key: key != "arrays"), st.integers() | st.text(max_size=8)),
    st.lists(st.tuples(st.sampled_from(sorted(protocol.DTYPES)), st.lists(st.integers(1, 5), min_size=1, max_size=4))),
)
@settings(max_examples=60, deadline=None)
def test_a_message_comes_out_as_it_went_in(header, layout):
    rng = np.random.default_rng(0)
    arrays = {f"a{i}": rng.integers(0, 100, shape).astype(dtype) for i, (dtype, shape) in enumerate(layout)}
    pieces = protocol.encode(header, {name: Array.of(array) for name, array in arrays.items()})
    came = received(b"".join(pieces))
    assert came.header == header
    assert list(came.arrays) == list(arrays)
    for name, array in arrays.items():
        values = np.asarray(came.arrays[name].view())
        assert values.dtype == array.dtype
        np.testing.assert_array_equal(values, array)


def test_a_large_picture_travels_whole(pair):
    picture = np.random.default_rng(1).random((700, 900, 4), np.float32)
    sender = threading.Thread(target=protocol.send, args=(pair[0], {"kind": "x"}, {"rgba": Array.of(picture)}))
    sender.start()
    came = protocol.receive(pair[1], deadline=time.monotonic() + 10)
    sender.join()
    np.testing.assert_array_equal(np.asarray(came.arrays["rgba"].view()), picture)


HOSTILE = {
    "a header longer than allowed": struct.pack("<I", protocol.HEADER_MAX_BYTES + 1),
    "a header of 4 GB": struct.pack("<I", 0xFFFFFFFF),
    "an empty header": struct.pack("<I", 0),
    "a header that is not UTF-8": framed(b"\xff\xfe{}"),
    "a header that is not JSON": framed(b"{'kind': 1}"),
    "a header that is a list": framed([]),
    "a header with NaN": framed(b'{"x": NaN}'),
    "a header with Infinity": framed(b'{"x": -Infinity}'),
    "a number with ten thousand digits": framed(b'{"x": ' + b"9" * 10000 + b"}"),
    "brackets nested thirty thousand deep": framed(b"[" * 30000 + b"]" * 30000),
    "arrays that are not a list": framed({"arrays": {}}),
    "too many arrays": framed({"arrays": [{"name": str(i), "dtype": "|u1", "shape": [1]} for i in range(65)]}),
    "an array without a shape": framed({"arrays": [{"name": "a", "dtype": "<f4"}]}),
    "an array with something more": announcing(strides=[4]),
    "an array of objects": announcing(dtype="|O"),
    "an array of a type that is no text": announcing(dtype=["<f4"]),
    "a big-endian array": announcing(dtype=">f4"),
    "a structured array": announcing(dtype="f4,f4"),
    "a shape that is a number": announcing(shape=2),
    "a shape without sizes": announcing(shape=[]),
    "a shape of five sizes": announcing(shape=[1, 1, 1, 1, 1]),
    "a negative size": announcing(shape=[-1, -4]),
    "a size of zero": announcing(shape=[0]),
    "a size that is true": announcing(shape=[True]),
    "a size with a fraction": announcing(shape=[1.5]),
    "more than a gigabyte": announcing(shape=[(1 << 28) + 1]),
    "sizes whose product overflows 64 bits": announcing(shape=[1 << 30, 1 << 30, 1 << 30]),
    "a gigabyte in two arrays": framed(
        {"arrays": [{"name": n, "dtype": "|u1", "shape": [(1 << 29) + 1]} for n in "ab"]}
    ),
    "the same name twice": framed({"arrays": [{"name": "a", "dtype": "|u1", "shape": [1]}] * 2}),
    "a name that is no text": announcing(name=3),
    "a name without end": announcing(name="a" * 1000),
}


@pytest.mark.parametrize("content", HOSTILE.values(), ids=HOSTILE.keys())
def test_a_hostile_message_is_refused_before_memory_is_taken(content):
    tracemalloc.start()
    try:
        with pytest.raises(ProtocolError):
            received(content + bytes(64))
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # worst observed 1.4 MB (a JSON parser on 64 kB of brackets); an allocated gigabyte would show
    assert peak < 4e6


@given(st.binary(max_size=400))
@settings(max_examples=200, deadline=None)
def test_random_bytes_raise_nothing_but_the_protocols_errors(content):
    with pytest.raises((ProtocolError, Disconnected)):
        received(content)


@pytest.mark.parametrize("cut", [0, 2, 4, 10, -1])
def test_a_message_cut_short_is_a_disconnection(cut):
    whole = b"".join(protocol.encode({"kind": "x"}, {"a": Array.of(np.zeros(100, np.float32))}))
    with pytest.raises(Disconnected) as caught:
        received(whole[:cut])
    assert caught.value.clean == (cut == 0)


@pytest.mark.parametrize(
    "array",
    [np.zeros((0, 3), np.float32), np.zeros(3, np.complex64), np.zeros((4, 4), np.float32)[:, ::2], np.float32(1)],
    ids=["empty", "complex", "strided", "scalar"],
)
def test_an_array_that_cannot_travel_is_refused_by_the_sender(array):
    with pytest.raises(ProtocolError):
        Array.of(array)


def test_a_header_too_long_is_refused_by_the_sender():
    with pytest.raises(ProtocolError, match="65536"):
        protocol.encode({"text": "x" * protocol.HEADER_MAX_BYTES})


@pytest.mark.parametrize("value", [float("nan"), float("inf"), np.float32(1), {1}], ids=repr)
def test_a_header_that_is_no_json_is_refused_by_the_sender(value):
    with pytest.raises(ProtocolError, match="JSON"):
        protocol.encode({"fx": value})


def test_the_token_decides_and_the_version_is_told(pair):
    token = bytes(range(32))
    deadline = time.monotonic() + 5
    pair[0].sendall(protocol.greeting(token) + protocol.greeting(bytes(32)))
    assert protocol.receive_greeting(pair[1], token, deadline=deadline) == protocol.PROTOCOL_VERSION
    assert protocol.receive_greeting(pair[1], token, deadline=deadline) is None
