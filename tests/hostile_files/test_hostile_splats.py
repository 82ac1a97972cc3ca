"""Splat files that are damaged or lie about themselves are refused by name, not by an error of the parser."""

from __future__ import annotations

import contextlib
import gzip
import json
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.files import FORMATS
from jghand_engine.export.splats.reading import read_splats, splat_findings

READ = ("ply", "splat", "glb", "spz")


def cloud(count: int = 300, axes: str = "rub") -> SplatCloud:
    rng = np.random.default_rng(4)
    turns = Rotation.from_quat(rng.normal(size=(count, 4))).as_quat(scalar_first=True)
    return SplatCloud(
        rng.uniform(-0.1, 0.1, (count, 3)), rng.uniform(0.0003, 0.002, (count, 3)), turns,
        rng.uniform(0.01, 0.99, count), rng.uniform(0, 1, (count, 3)), axes,
    )  # fmt: skip


def content(format: str, count: int = 300) -> bytes:
    return FORMATS[format].encode(cloud(count))


def refused_content(folder: Path, format: str, data: bytes, *words: str) -> str:
    path = folder / f"hand.{format}"
    path.write_bytes(data)
    with pytest.raises(InputError) as caught:
        read_splats(path)
    message = str(caught.value)
    assert all(word in message for word in (path.name, *words)), message
    return message


# turn: half the angle between rotations, radians: rounding of float32, steps of 1/128, steps of 9 bits
@pytest.mark.parametrize(("format", "turn"), [("ply", 5e-4), ("splat", 0.01), ("glb", 5e-4), ("spz", 0.002)])
def test_what_we_write_is_read_back(tmp_path, format, turn):
    path, wanted = tmp_path / f"hand.{format}", cloud()
    path.write_bytes(content(format))
    read = read_splats(path)
    assert len(read) == 300
    assert not list(splat_findings(read))
    assert np.abs(read.positions_m - wanted.positions_m).max() < 3e-6
    assert np.abs(np.log(read.scales_m / wanted.scales_m)).max() < 0.0313
    assert np.abs(read.opacity - wanted.opacity).max() < 0.002
    assert np.abs(read.rgb - wanted.rgb).max() < 0.0038
    lengths = np.linalg.norm(read.rotations_wxyz, axis=1)
    cosine = np.abs((read.rotations_wxyz * wanted.rotations_wxyz).sum(1)) / lengths
    assert 1 - cosine.min() < turn**2 / 2
    assert read.axes == ("" if format == "splat" else "rub")


@pytest.mark.parametrize("format", READ)
def test_a_file_that_is_cut_off_anywhere_is_refused(tmp_path, format):
    whole = content(format)
    for length in {0, 1, 3, 11, 19, 20, 31, 33, 500, len(whole) // 2 + 1, len(whole) - 31, len(whole) - 1}:
        refused_content(tmp_path, format, whole[:length])


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


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("json", [(), ("--json", "facts.json")])
def test_info_tells_of_huge_distances_in_a_sentence(tmp_path, capsys, monkeypatch, json):
    monkeypatch.chdir(tmp_path)
    changed = cloud()
    changed.positions_m[:2, 0] = 3e38, -3e38
    path = tmp_path / "hand.ply"
    path.write_bytes(FORMATS["ply"].encode(changed))
    assert main(["info", str(path), *json]) == 0
    assert "reach over 6e+38 m" in capsys.readouterr().out


def glb(about: object, binary: bytes = b"", *, text: bytes | None = None) -> bytes:
    text = json.dumps(about).encode() if text is None else text
    text += b" " * (-len(text) % 4)
    total = 20 + len(text) + 8 + len(binary)
    head = struct.pack("<IIIII", 0x46546C67, 2, total, len(text), 0x4E4F534A)
    return head + text + struct.pack("<II", len(binary), 0x004E4942) + binary


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


def spz(count: int, *, version: int = 3, degree: int = 0, bits: int = 12, payload: bytes = b"") -> bytes:
    head = struct.pack("<IIIBBBB", 0x5053474E, version, count, degree, bits, 0, 0)
    return gzip.compress(head + payload, mtime=0)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (spz(2**32 - 1), "buffer"),
        (spz(1000), "buffer"),
        (spz(1, version=1, payload=bytes(19)), "version 1"),
        (spz(1, version=9, payload=bytes(20)), "version 9"),
        (spz(1, bits=200, payload=bytes(20)), "header"),
        (spz(1, payload=bytes(19)), "buffer"),
        (spz(1, payload=bytes(30_000_000)), "more than hands do"),
        (gzip.compress(b"short"), "unpack"),
    ],
)
def test_spz_files_that_lie_or_are_bombs_are_refused(tmp_path, data, word):
    refused_content(tmp_path, "spz", data, word)


def test_harmonics_of_higher_degrees_are_left_out(tmp_path):
    plain = gzip.decompress(content("spz"))
    path = tmp_path / "hand.spz"
    path.write_bytes(gzip.compress(plain[:12] + b"\x03" + plain[13:] + bytes(300 * 45), mtime=0))
    assert np.abs(read_splats(path).positions_m - cloud().positions_m).max() < 3e-6


@pytest.mark.parametrize("format", READ)
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(place=st.integers(0, 3000), value=st.integers(0, 255))
def test_any_changed_byte_is_read_or_refused_and_nothing_else(tmp_path, format, place, value):
    data = bytearray(content(format, 50))
    data[place % len(data)] = value
    path = tmp_path / f"changed.{format}"
    path.write_bytes(bytes(data))
    with contextlib.suppress(InputError):
        assert len(read_splats(path)) <= 50


def test_sizes_and_opacities_of_the_wrong_kind_are_told_in_sentences(tmp_path):
    def found(changed: SplatCloud, format: str) -> str:
        path = tmp_path / f"hand.{format}"
        path.write_bytes(FORMATS[format].encode(changed))
        return " ".join(splat_findings(read_splats(path)))

    right = cloud()
    e = np.exp
    # logarithms where meters are wanted, and meters where logarithms are
    assert "probably logarithms" in found(SplatCloud(**vars(right) | {"scales_m": np.log(right.scales_m)}), "glb")
    assert "probably linear" in found(SplatCloud(**vars(right) | {"scales_m": e(right.scales_m)}), "ply")
    logits = np.log(right.opacity / (1 - right.opacity))
    assert "probably logits" in found(SplatCloud(**vars(right) | {"opacity": logits}), "glb")
    assert "no length" in found(SplatCloud(**vars(right) | {"rotations_wxyz": np.zeros((300, 4))}), "glb")


def test_info_says_what_is_in_a_splat_file_and_refuses_a_broken_one(tmp_path, capsys):
    path = tmp_path / "hand.spz"
    path.write_bytes(content("spz"))
    assert main(["info", str(path)]) == 0
    assert "spz splats" in capsys.readouterr().out
    path.write_bytes(content("spz")[:-1])
    assert main(["info", str(path)]) == 2
    assert "cut off" in capsys.readouterr().err
