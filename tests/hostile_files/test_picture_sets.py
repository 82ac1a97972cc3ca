"""Damaged and malicious data sets: an InputError that names the place; nothing outside is read, nothing huge made."""

from __future__ import annotations

import copy
import json
import random
import shutil
import struct
import zlib

import pytest
from picture_sets import edited, recorded, write_hanco, write_set

from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.captures.captures import CaptureChoice
from jghand_engine.captures.image_files import probe_image, read_image, read_mask
from jghand_engine.errors import InputError

NONSENSE = (None, "", "x", -1, 10**400, 1e308, float("nan"), float("inf"), True, [], [[]], {}, {"0": 1}, [None] * 42)


@pytest.fixture(scope="module")
def interhand(tmp_path_factory):
    return write_set(tmp_path_factory.mktemp("interhand"), recorded(frames=1))


@pytest.fixture(scope="module")
def hanco(tmp_path_factory):
    return write_hanco(tmp_path_factory.mktemp("hanco"), (2,), frames=1)


def places(content, path=()):
    """Every place in nested lists and dicts, but of long lists only the ends."""
    yield path
    if isinstance(content, dict):
        for key in content:
            yield from places(content[key], (*path, key))
    elif isinstance(content, list):
        for index in {0, len(content) - 1} if content else ():
            yield from places(content[index], (*path, index))


def replaced(content, path, value):
    changed = copy.deepcopy(content)
    inner = changed
    for step in path[:-1]:
        inner = inner[step]
    if path:
        inner[path[-1]] = value
        return changed
    return value


def opens_or_refuses(folder, choice=None):
    """True for a capture, False for an InputError. Anything else fails the test."""
    try:
        return len(open_capture(folder, choice=choice)) > 0
    except InputError:
        return False


def try_nonsense_everywhere(file, folder, seed, tries, choice=None):
    whole = file.read_text()
    content, source = json.loads(whole), random.Random(seed)
    every = sorted(places(content), key=str)
    try:
        for path in source.sample(every, min(tries, len(every))):
            file.write_text(json.dumps(replaced(content, path, source.choice(NONSENSE))))
            opens_or_refuses(folder, choice)
    finally:
        file.write_text(whole)
    assert opens_or_refuses(folder, choice)


@pytest.mark.parametrize("kind", ["data", "camera", "joint_3d"])
def test_nonsense_anywhere_in_the_annotations_is_refused_or_harmless(interhand, kind):
    file = interhand / f"annotations/train/InterHand2.6M_train_{kind}.json"
    try_nonsense_everywhere(file, interhand, seed=len(kind), tries=30)


@pytest.mark.parametrize("name", ["meta.json", "calib/0002/00000000.json", "xyz/0002/00000000.json"])
def test_nonsense_anywhere_in_hanco_is_refused_or_harmless(hanco, name):
    try_nonsense_everywhere(hanco / name, hanco, seed=len(name), tries=30, choice=CaptureChoice(sequences=("2",)))


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe\x00", b"[" * 200_000, b"null", b"[1]", b'"text"'])
@pytest.mark.parametrize("kind", ["data", "camera", "joint_3d"])
def test_a_file_that_is_no_json_object_is_named(interhand, kind, content):
    file = interhand / f"annotations/train/InterHand2.6M_train_{kind}.json"
    whole = file.read_bytes()
    file.write_bytes(content)
    try:
        with pytest.raises(InputError, match=file.name):
            open_capture(interhand)
    finally:
        file.write_bytes(whole)


@pytest.mark.parametrize(
    "name",
    [
        "../../../../etc/passwd",
        "/etc/passwd",
        "Capture0/../../../x/y.png",
        "C:/a/b/c/d.png",
        "..\\..\\..\\x\\y.png",
        "a",
    ],
)
def test_no_picture_outside_the_set_is_read(interhand, tmp_path, name):
    folder = shutil.copytree(interhand, tmp_path / "set")
    with edited(folder, "data") as content:
        content["images"][0]["file_name"] = name
    with pytest.raises(InputError, match=r"annotation 0 in .*file_name"):
        open_capture(folder)


def png_that_claims(width, height):
    """The smallest PNG that says it has so many pixels."""

    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = struct.pack(">IIBBBBB", width, height, 8, 6, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


@pytest.mark.parametrize("reader", [probe_image, read_image, read_mask])
@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\x89PNG\r\n\x1a\n",
        b"\xff\xd8\xff",
        b"\xff\xd8\xff\xd9",
        b"GIF89a",
        bytes(1000),
        png_that_claims(60000, 60000),
    ],
)
def test_what_is_no_picture_is_refused_by_name_and_nothing_huge_is_made(tmp_path, reader, content):
    file = tmp_path / "picture.png"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"picture\.png"):
        reader(file)
    with pytest.raises(InputError):
        reader(tmp_path)
