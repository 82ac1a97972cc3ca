"""Splat files that are damaged, lie about themselves or attack the reader: refused by name, with little memory."""

from __future__ import annotations

import contextlib
import gzip
import json
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.exporters.ply import PROPERTIES
from jghand_engine.exporters.splat_cloud import SplatCloud
from jghand_engine.exporters.splat_files import FORMATS
from jghand_engine.exporters.splat_reading import read_splats

READ = ("ply", "splat", "glb", "spz")
# bytes that a refusal may take beside twice the file: the pieces that are read at once, the sentence
SOME = 2_000_000


def cloud(count: int = 300, axes: str = "rub") -> SplatCloud:
    rng = np.random.default_rng(4)
    turns = Rotation.from_quat(rng.normal(size=(count, 4))).as_quat(scalar_first=True)
    return SplatCloud(
        rng.uniform(-0.1, 0.1, (count, 3)), rng.uniform(0.0003, 0.002, (count, 3)), turns,
        rng.uniform(0.01, 0.99, count), rng.uniform(0, 1, (count, 3)), axes,
    )  # fmt: skip


def content(format: str, count: int = 300) -> bytes:
    return FORMATS[format].encode(cloud(count))


def refused(path: Path, *words: str) -> str:
    """Reads the file, which must be refused by name, with at most twice its memory."""
    tracemalloc.start()
    try:
        with pytest.raises(InputError) as caught:
            read_splats(path)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    message = str(caught.value)
    assert path.name in message
    for word in words:
        assert word in message, message
    assert peak <= 2 * path.stat().st_size + SOME
    return message


def refused_content(folder: Path, format: str, data: bytes, *words: str) -> str:
    path = folder / f"hand.{format}"
    path.write_bytes(data)
    return refused(path, *words)


# turn: half the angle between rotations, radians: rounding of float32, steps of 1/128, steps of 9 bits
@pytest.mark.parametrize(("format", "turn"), [("ply", 5e-4), ("splat", 0.01), ("glb", 5e-4), ("spz", 0.002)])
def test_what_we_write_is_read_back(tmp_path, format, turn):
    path, wanted = tmp_path / f"hand.{format}", cloud()
    path.write_bytes(content(format))
    read = read_splats(path)
    assert read.findings == ()
    assert np.abs(read.cloud.positions_m - wanted.positions_m).max() < 3e-6
    assert np.abs(np.log(read.cloud.scales_m / wanted.scales_m)).max() < 0.0313
    assert np.abs(read.cloud.opacity - wanted.opacity).max() < 0.002
    assert np.abs(read.cloud.rgb - wanted.rgb).max() < 0.0038
    lengths = np.linalg.norm(read.cloud.rotations_wxyz, axis=1)
    cosine = np.abs((read.cloud.rotations_wxyz * wanted.rotations_wxyz).sum(1)) / lengths
    assert 1 - cosine.min() < turn**2 / 2
    assert read.cloud.axes == ("" if format == "splat" else "rub")


@pytest.mark.parametrize("format", READ)
def test_a_file_that_is_cut_off_anywhere_is_refused(tmp_path, format):
    whole = content(format)
    for length in {0, 1, 3, 11, 19, 20, 31, 33, 500, len(whole) // 2 + 1, len(whole) - 31, len(whole) - 1}:
        refused_content(tmp_path, format, whole[:length])


@pytest.mark.parametrize("format", READ)
def test_trailing_rubbish_is_refused(tmp_path, format):
    refused_content(tmp_path, format, content(format) + b"rubbish")


@pytest.mark.parametrize("format", READ)
def test_a_file_of_another_kind_is_refused(tmp_path, format):
    for other in (b"\x89PNG\r\n\x1a\n" + bytes(25), b"ply\n" * 10_001, bytes(100_001), b"\xff" * 100_001):
        refused_content(tmp_path, format, other)


@pytest.mark.parametrize("format", ["ply", "splat", "glb"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_refused_however_large_the_file(tmp_path, format, value):
    count = 60_000
    whole = bytearray(content(format, count))
    # the last coordinate, of positions that follow each other or lie in rows
    last = {"ply": len(whole) - 68 + 8, "splat": len(whole) - 32 + 8, "glb": len(whole) - count * 44 - 4}[format]
    whole[last : last + 4] = struct.pack("<f", value)
    refused_content(tmp_path, format, bytes(whole), "positions_m", "NaN or infinity")


def ply(*lines: str, data: bytes = b"") -> bytes:
    return "\n".join(("ply", *lines, "end_header\n")).encode("latin-1") + data


BINARY = "format binary_little_endian 1.0"
FLOATS = tuple(f"property float {name}" for name in PROPERTIES)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (ply("format ascii 1.0", "element vertex 1", *FLOATS), "binary_little_endian"),
        (ply("format binary_big_endian 1.0", "element vertex 1", *FLOATS), "binary_little_endian"),
        (ply(BINARY), "element"),
        (ply(BINARY, "element face 3", *FLOATS), "element"),
        (ply(BINARY, "element vertex 999999999999", *FLOATS), "bytes"),
        (ply(BINARY, "element vertex 99999999999999999999999", *FLOATS), "count"),
        (ply(BINARY, "element vertex -1", *FLOATS), "count"),
        (ply(BINARY, "element vertex 1e9", *FLOATS), "count"),
        (ply(BINARY, "element vertex 1", "property list uchar int vertex_indices"), "one number"),
        (ply(BINARY, "element vertex 1", "property quaternion x"), "one number"),
        (ply(BINARY, "element vertex 1", "property float x", "property float x"), "once"),
        (ply(BINARY, "element vertex 1", *FLOATS, "element face 1"), "one element"),
        (ply(BINARY, "element vertex 1", "property float x", data=bytes(4)), "f_dc_0"),
        (ply(BINARY, "element vertex 1"), "properties"),
        (ply("comment " + "x" * 70_000, BINARY, "element vertex 1", *FLOATS), "header"),
        (ply("comment \xe9", BINARY, "element vertex 1", *FLOATS), "letters"),
        (b"ply\n" + b"a\n" * 40_000, "header"),
        (b"ply\nend_header\n", "header"),
    ],
)
def test_ply_headers_that_lie_are_refused(tmp_path, data, word):
    refused_content(tmp_path, "ply", data, word)


def glb(about: object, binary: bytes = b"", *, text: bytes | None = None) -> bytes:
    text = json.dumps(about).encode() if text is None else text
    text += b" " * (-len(text) % 4)
    total = 20 + len(text) + 8 + len(binary)
    head = struct.pack("<IIIII", 0x46546C67, 2, total, len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(binary), 0x004E4942) + binary


def glb_parts() -> tuple[dict, bytes]:
    whole = content("glb")
    (length,) = struct.unpack_from("<I", whole, 12)
    return json.loads(whole[20 : 20 + length]), whole[28 + length :]


def test_the_parts_these_are_made_from_are_read(tmp_path):
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(*glb_parts()))
    assert len(read_splats(path).cloud) == 300


@pytest.mark.parametrize(
    "text",
    [
        b"", b"{", b"[]", b"null", b"[" * 100_000, b'{"meshes":' * 20_000, b'{"meshes": 7}', b'{"meshes": [7]}',
        b'{"meshes": [{"primitives": {}}]}', b'{"meshes": [{"primitives": [[]]}]}', b"\xff\xfe", b"1" * 5000,
        b'{"meshes": [{"primitives": [{"extensions": 3}]}]}', b" " * 65_537,
        b'{"meshes": [' + b"[]," * 21_000 + b"[]]}", b'{"meshes": [' + b'{"a":0},' * 8_000 + b"7]}",
    ],
)  # fmt: skip
def test_descriptions_that_are_none_are_refused(tmp_path, text):
    refused_content(tmp_path, "glb", glb(None, text=text))


@pytest.mark.parametrize("value", [-1, 2**31, 2**63, 1e300, True, None, "0", [], {}, 301])
@pytest.mark.parametrize(
    ("place", "name"),
    [
        ("accessors", "bufferView"), ("accessors", "count"), ("accessors", "componentType"), ("accessors", "type"),
        ("accessors", "byteOffset"), ("bufferViews", "buffer"), ("bufferViews", "byteOffset"),
        ("bufferViews", "byteLength"),
    ],
)  # fmt: skip
def test_accessors_that_point_elsewhere_are_refused(tmp_path, place, name, value):
    about, binary = glb_parts()
    for entry in about[place]:
        entry[name] = value
    refused_content(tmp_path, "glb", glb(about, binary))


@pytest.mark.parametrize("stride", [0, 1, 3, 2**39])
def test_rows_that_overlap_or_end_beyond_their_bytes_are_refused(tmp_path, stride):
    about, binary = glb_parts()
    about["bufferViews"][1]["byteStride"] = stride
    refused_content(tmp_path, "glb", glb(about, binary))


def test_a_glb_whose_numbers_lie_in_another_file_is_refused(tmp_path):
    about, binary = glb_parts()
    about["buffers"][0]["uri"] = "/etc/passwd"
    refused_content(tmp_path, "glb", glb(about, binary), "another file")


def test_attributes_of_different_lengths_are_refused(tmp_path):
    about, binary = glb_parts()
    about["accessors"][1]["count"] = 299
    refused_content(tmp_path, "glb", glb(about, binary), "different lengths")


def spz(count: int, *, version: int = 3, degree: int = 0, bits: int = 12, payload: bytes = b"") -> bytes:
    head = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, bits, 0, 0)
    return gzip.compress(head + payload, mtime=0)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (spz(2**32 - 1), "Gaussians"),
        (spz(1000), "Gaussians"),
        (spz(50_000_000, payload=bytes(10_000_000)), "Gaussians"),
        (spz(1, version=1, payload=bytes(19)), "version 1"),
        (spz(1, version=9, payload=bytes(20)), "version 9"),
        (spz(1, degree=4, payload=bytes(20)), "degree 4"),
        (spz(1, bits=200, payload=bytes(20)), "200 bits"),
        (spz(1, payload=bytes(19)), "36 bytes"),
        (spz(1, payload=bytes(30_000_000)), "more"),
        (struct.pack("<III", 0x5053474E, 4, 10**9) + bytes(200), "version 4"),
        (gzip.compress(b"short"), "gzip"),
    ],
)
def test_spz_files_that_lie_or_are_bombs_are_refused(tmp_path, data, word):
    refused_content(tmp_path, "spz", data, word)


def test_a_wrong_checksum_is_noticed(tmp_path):
    data = bytearray(content("spz"))
    data[-5] ^= 1
    refused_content(tmp_path, "spz", bytes(data), "gzip")


@pytest.mark.parametrize("format", READ)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 3000), value=st.integers(0, 255))
def test_any_changed_byte_is_read_or_refused_and_nothing_else(tmp_path, format, place, value):
    data = bytearray(content(format, 50))
    data[place % len(data)] = value
    path = tmp_path / f"changed.{format}"
    path.write_bytes(bytes(data))
    with contextlib.suppress(InputError):
        assert len(read_splats(path).cloud) <= 50


def test_sizes_and_opacities_of_the_wrong_kind_are_told_in_sentences(tmp_path):
    def found(changed: SplatCloud, format: str) -> str:
        path = tmp_path / f"hand.{format}"
        path.write_bytes(FORMATS[format].encode(changed))
        return " ".join(read_splats(path).findings)

    right = cloud()
    e = np.exp
    # logarithms where metres are wanted, and metres where logarithms are
    assert "probably logarithms" in found(SplatCloud(**vars(right) | {"scales_m": np.log(right.scales_m)}), "glb")
    assert "probably linear" in found(SplatCloud(**vars(right) | {"scales_m": e(right.scales_m)}), "ply")
    logits = np.log(right.opacity / (1 - right.opacity))
    assert "probably logits" in found(SplatCloud(**vars(right) | {"opacity": logits}), "glb")
    assert "no logits" in found(SplatCloud(**vars(right) | {"opacity": 1 / (1 + e(-right.opacity))}), "ply")
    assert "no length" in found(SplatCloud(**vars(right) | {"rotations_wxyz": np.zeros((300, 4))}), "glb")


def test_info_says_what_is_in_a_splat_file_and_refuses_a_broken_one(tmp_path, capsys):
    path = tmp_path / "hand.spz"
    path.write_bytes(content("spz"))
    assert main(["info", str(path)]) == 0
    assert "spz splats" in capsys.readouterr().out
    path.write_bytes(content("spz")[:-1])
    assert main(["info", str(path)]) == 2
    assert "cut off" in capsys.readouterr().err
