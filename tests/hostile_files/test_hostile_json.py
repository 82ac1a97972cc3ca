"""Cameras and maps of bones that are damaged or attack the reader: refused by name, quickly and with little memory."""

from __future__ import annotations

import json
import tracemalloc

import pytest

from jghand_engine.cli import main
from jghand_engine.errors import InputError
from jghand_engine.export.camera_file import read_camera
from jghand_engine.json_files import JSON_BYTES_MAX

CAMERA = {
    "width": 64, "height": 48, "fx": 90.0, "fy": 90.0, "cx": 32.0, "cy": 24.0,
    "camera_from_world": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0.5], [0, 0, 0, 1]],
}  # fmt: skip
# what is no JSON, or would take down who reads it
CONTENTS = {
    "empty": "", "cut off": '{"width": 64', "nested": "[" * 50_000, "nested objects": '{"a":' * 16_000,
    "no text": b"\xff\xfe\x00", "a number of 5000 digits": "9" * 5000, "NaN": "NaN", "Infinity": '{"width": -Infinity}',
    "too large": '{"width":[' + "[]," * 500_000 + "[]]}", "a list": "[]", "null": "null",
}  # fmt: skip
NUMBERS = ["1" + "0" * 400, "1e400", "-1e400", "1e300", "NaN", "Infinity", "true", "[]", "{}", '"64"', "null", "1e7"]


def written(folder, content) -> str:
    path = folder / "given.json"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return str(path)


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_a_camera_or_a_map_of_bones_that_is_no_json_ends_in_a_sentence(tmp_path, capsys, content):
    path = written(tmp_path, content)
    (tmp_path / "a.bvh").write_text("HIERARCHY")
    for words in (
        ("render", "--poses", "open", "--camera", path),
        ("motion", str(tmp_path / "a.bvh"), "--out", str(tmp_path / "out.npz"), "--bones", path),
    ):
        more = ("--out", str(tmp_path / "out")) if words[0] == "render" else ()
        assert main([*words, *more]) == 2
        assert "given.json" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_large_file_is_not_read(tmp_path):
    path = written(tmp_path, b" " * 50 * JSON_BYTES_MAX)
    tracemalloc.start()
    try:
        with pytest.raises(InputError, match=f"bytes, got {50 * JSON_BYTES_MAX}. Check the name"):
            read_camera(tmp_path / path)
        assert tracemalloc.get_traced_memory()[1] < 3 * JSON_BYTES_MAX
    finally:
        tracemalloc.stop()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("name", ["width", "height", "fx", "fy", "cx", "cy", "camera_from_world"])
def test_a_number_of_a_camera_that_is_none_is_named(tmp_path, name, number):
    content = json.dumps(CAMERA | {name: "@" if name != "camera_from_world" else [["@"] * 4] * 4}).replace(
        '"@"', number
    )
    with pytest.raises(InputError) as caught:
        read_camera(tmp_path / written(tmp_path, content))
    assert name in str(caught.value) or "which is no number" in str(caught.value)


def test_the_camera_that_these_are_made_from_is_read(tmp_path):
    assert read_camera(tmp_path / written(tmp_path, json.dumps(CAMERA))).width == 64
