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
from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.files import FORMATS
from jghand_engine.export.splats.ply import PROPERTIES
from jghand_engine.export.splats.reading import open_splats, read_splats

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


def whole(path: Path) -> SplatCloud:
    """All Gaussians of a file, which must be whole."""
    with open_splats(path) as rows:
        parts = list(rows.parts())
    names = ("positions_m", "scales_m", "rotations_wxyz", "opacity", "rgb")
    return SplatCloud(*(np.concatenate([getattr(part, name) for part in parts]) for name in names), rows.axes)


def taken(path: Path) -> int:
    """Bytes that reading a good file takes at most."""
    tracemalloc.start()
    try:
        read_splats(path)
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


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
    read, facts = whole(path), read_splats(path)
    assert (facts.format, facts.gaussians, facts.axes, facts.findings) == (format, 300, read.axes, ())
    assert np.abs(np.array(facts.size_m) - np.ptp(wanted.positions_m, axis=0)).max() < 1e-5
    assert facts.sigma_m == (read.scales_m.min(), read.scales_m.max())
    assert facts.opacity == (read.opacity.min(), read.opacity.max())
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
        (ply(BINARY, "element vertex 1", *FLOATS, "element face 1", "property list uchar int i"), "one number"),
        (ply(BINARY, "element vertex 1", *FLOATS, "element camera 1", "property float x", data=bytes(68)), "bytes"),
        (ply(BINARY, "element vertex 0", *FLOATS, "element camera 999999999999", "property double x"), "bytes"),
        (ply(BINARY, "property float x", "element vertex 1"), "property float x"),
        (ply(BINARY, "element vertex 1", *FLOATS, "element"), "element"),
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


def test_elements_of_fixed_size_after_the_vertices_are_left_out(tmp_path):
    head, data = content("ply").split(b"end_header\n", 1)
    more = b"element camera 2\nproperty float x\nproperty uchar kind\n"
    path = tmp_path / "hand.ply"
    path.write_bytes(head + more + b"end_header\n" + data + bytes(10))
    assert np.abs(whole(path).positions_m - cloud().positions_m).max() < 1e-7
    refused_content(tmp_path, "ply", path.read_bytes() + b"0", "bytes")


def test_a_ply_of_narrow_numbers_takes_no_memory_whether_good_or_not(tmp_path):
    """Properties in bytes would grow fourfold in float32; the number that is none comes last."""
    names = [name for name in PROPERTIES if name not in ("nx", "ny", "nz")]
    kinds = {name: "f4" if name == "scale_2" else "u1" for name in names}
    table = np.zeros(500_000, np.dtype(list(kinds.items())))
    lines = [f"property {'float' if kind == 'f4' else 'uchar'} {name}" for name, kind in kinds.items()]
    path = tmp_path / "hand.ply"
    path.write_bytes(ply(BINARY, "element vertex 500000", *lines, data=table.tobytes()))
    assert taken(path) < SOME
    table["scale_2"][-1] = np.nan
    refused_content(tmp_path, "ply", ply(BINARY, "element vertex 500000", *lines, data=table.tobytes()), "scales_m")


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


def glb_parts() -> tuple[dict, bytes]:
    whole = content("glb")
    (length,) = struct.unpack_from("<I", whole, 12)
    return json.loads(whole[20 : 20 + length]), whole[28 + length :]


def test_the_parts_these_are_made_from_are_read(tmp_path):
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(*glb_parts()))
    assert read_splats(path).gaussians == 300


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


def glb_of_few_bytes() -> tuple[dict, np.ndarray]:
    """A description whose attributes all share the same four bytes of each row, but for positions."""
    count, prefix = 500_000, "KHR_gaussian_splatting"
    kinds = {"POSITION": "VEC3", f"{prefix}:ROTATION": "VEC4", f"{prefix}:SCALE": "VEC3", f"{prefix}:OPACITY": "SCALAR"}
    accessors = [
        {"bufferView": int(k > 0), "componentType": 5121 if k else 5126, "count": count, "type": kind}
        for k, kind in enumerate(kinds.values())
    ]
    attributes = {name: k for k, name in enumerate(kinds)} | {f"{prefix}:SH_DEGREE_0_COEF_0": 2}
    views = [
        {"buffer": 0, "byteOffset": 4 * count, "byteLength": 12 * count},
        {"buffer": 0, "byteLength": 4 * count, "byteStride": 4},
    ]
    mesh = {"primitives": [{"attributes": attributes, "extensions": {prefix: {}}}]}
    about = {"accessors": accessors, "bufferViews": views, "buffers": [{}], "meshes": [mesh]}
    return about, np.zeros(4 * count, "<f4")


def test_a_glb_whose_attributes_share_bytes_takes_no_memory_whether_good_or_not(tmp_path):
    about, numbers = glb_of_few_bytes()
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(about, numbers.tobytes()))
    assert taken(path) < SOME
    numbers[-1] = np.nan
    refused_content(tmp_path, "glb", glb(about, numbers.tobytes()), "positions_m")


def test_whole_numbers_stand_for_parts_of_one_only_where_the_file_says_so(tmp_path):
    about, binary = glb_parts()
    opacity = next(k for k, a in enumerate(about["accessors"]) if a["type"] == "SCALAR")
    turn = next(k for k, a in enumerate(about["accessors"]) if a["type"] == "VEC4" and a["componentType"] == 5126)
    path, start = tmp_path / "hand.glb", len(binary)
    binary += np.full(300, 51, np.uint8).tobytes() + np.full((300, 4), -128, np.int8).tobytes()
    about["bufferViews"] += [
        {"buffer": 0, "byteOffset": start, "byteLength": 300},
        {"buffer": 0, "byteOffset": start + 300, "byteLength": 1200},
    ]
    about["accessors"][opacity] |= {"bufferView": len(about["bufferViews"]) - 2, "componentType": 5121}
    about["accessors"][turn] |= {"bufferView": len(about["bufferViews"]) - 1, "componentType": 5120, "normalized": True}
    path.write_bytes(glb(about, binary))
    assert (whole(path).opacity == 51).all()
    assert (whole(path).rotations_wxyz == -1).all()
    about["accessors"][opacity]["normalized"] = True
    path.write_bytes(glb(about, binary))
    assert np.allclose(whole(path).opacity, 0.2)


@pytest.mark.parametrize("nodes", [
    [{"mesh": 0, "translation": [1, 0, 0]}], [{"mesh": 0}, {"children": [0], "matrix": [2.0] * 16}],
    [{"mesh": 0, "children": [1]}, {"children": [0], "scale": [2, 2, 2]}],
])  # fmt: skip
def test_nodes_that_place_the_gaussians_are_told(tmp_path, nodes):
    about, binary = glb_parts()
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(about | {"nodes": nodes}, binary))
    assert "before that" in read_splats(path).findings[0]
    path.write_bytes(glb(about | {"nodes": [{"mesh": 0}, {"translation": [1, 0, 0]}]}, binary))
    assert read_splats(path).findings == ()


@pytest.mark.parametrize("node", [
    {"matrix": np.eye(4).ravel().tolist()}, {"matrix": np.eye(4, dtype=int).ravel().tolist()},
    {"translation": [0, 0, 0.0], "rotation": [0, 0, 0, 1], "scale": [1.0, 1, 1]}, {"rotation": [0, 0, -0.0, 1]},
])  # fmt: skip
def test_nodes_that_place_the_gaussians_where_they_are_do_not_matter(tmp_path, node):
    """Many programs write a map for every node."""
    about, binary = glb_parts()
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(about | {"nodes": [{"mesh": 0, **node}]}, binary))
    assert read_splats(path).findings == ()


@pytest.mark.parametrize("node", [{"translation": 7}, {"scale": None}, {"matrix": [[1]]}, {"rotation": "none"}])
def test_maps_of_nodes_that_are_none_are_told_as_maps(tmp_path, node):
    about, binary = glb_parts()
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(about | {"nodes": [{"mesh": 0, **node}]}, binary))
    assert "before that" in read_splats(path).findings[0]


@pytest.mark.parametrize(("nodes", "word"), [
    (7, "nodes"), ([7], "int"), ([{"children": 7}], "children"),
])  # fmt: skip
def test_nodes_that_are_none_are_refused(tmp_path, nodes, word):
    about, binary = glb_parts()
    refused_content(tmp_path, "glb", glb(about | {"nodes": nodes}, binary), word)


@pytest.mark.parametrize("nodes", [[{"mesh": 0, "children": [[]]}] * 2, [{"children": [99]}]])
def test_children_that_are_none_do_not_matter(tmp_path, nodes):
    about, binary = glb_parts()
    path = tmp_path / "hand.glb"
    path.write_bytes(glb(about | {"nodes": nodes}, binary))
    assert read_splats(path).findings == ()


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


def test_harmonics_of_higher_degrees_are_left_out(tmp_path):
    plain = gzip.decompress(content("spz"))
    path = tmp_path / "hand.spz"
    path.write_bytes(gzip.compress(plain[:12] + b"\x03" + plain[13:] + bytes(300 * 45), mtime=0))
    assert np.abs(whole(path).positions_m - cloud().positions_m).max() < 3e-6


def test_an_spz_that_grows_more_than_hands_do_is_refused_and_others_take_what_they_unpack_to(tmp_path):
    payload = np.random.default_rng(0).integers(0, 256, 2_000_000, np.uint8).tobytes()
    refused_content(tmp_path, "spz", spz(500_000, payload=payload + bytes(8_000_000)), "at most 4 times")
    refused_content(tmp_path, "spz", spz(350_000, payload=payload + bytes(4_999_999)), "bytes unpacked")
    path = tmp_path / "hand.spz"
    path.write_bytes(spz(350_000, payload=payload + bytes(5_000_000)))
    assert taken(path) < 7_000_000 + SOME


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
        assert read_splats(path).gaussians <= 50


def test_sizes_and_opacities_of_the_wrong_kind_are_told_in_sentences(tmp_path):
    def found(changed: SplatCloud, format: str) -> str:
        path = tmp_path / f"hand.{format}"
        path.write_bytes(FORMATS[format].encode(changed))
        return " ".join(read_splats(path).findings)

    right = cloud()
    e = np.exp
    # logarithms where meters are wanted, and meters where logarithms are
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
