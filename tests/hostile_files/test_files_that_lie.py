"""Files that are whole and lie: about their sizes, their numbers, or what lies beside them. Refused by name, soon."""

import json
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import safetensors.numpy
from picture_sets import edited, recorded, write_set
from sound_files import KINDS, TOLD

from jghand_engine.avatar.file import METADATA_KEY, load_avatar
from jghand_engine.captures.capture_folder import open_capture
from jghand_engine.errors import InputError
from jghand_engine.export.video import ffmpeg_program, write_video
from jghand_engine.motion.read import read_motion_file
from jghand_engine.track import video
from jghand_engine.track.video import open_video, read_frames

Parts = tuple[dict[str, np.ndarray], dict[str, Any]]


# ---- avatars ---------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=["avatar", "trained avatar", "avatar in known light", "distilled avatar"])
def parts(request, tmp_path_factory) -> Parts:
    """A sound avatar file as arrays and description."""
    path = tmp_path_factory.mktemp("sound") / "a.jghand"
    path.write_bytes(KINDS[request.param].sound(path))
    with safetensors.safe_open(str(path), framework="numpy") as opened:
        return safetensors.numpy.load_file(path), json.loads(opened.metadata()[METADATA_KEY])


def refused_avatar(folder: Path, arrays: dict[str, np.ndarray], about: Any, *words: str) -> None:
    path = folder / "wrong.jghand"
    text = about if isinstance(about, str) else json.dumps(about)
    whole = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    path.write_bytes(safetensors.numpy.save(whole, metadata={METADATA_KEY: text}))
    with pytest.raises(InputError) as caught:
        load_avatar(path)
    message = str(caught.value)
    assert all(word in message for word in (path.name, *words)), message
    assert caught.value.remedy


def test_an_avatar_of_a_newer_version_says_to_update(tmp_path, parts):
    arrays, about = parts
    refused_avatar(tmp_path, arrays, {**about, "format_version": 99}, "newer JGHand", "update")


def test_every_array_of_an_avatar_is_missed_and_its_length_type_and_numbers_looked_at(tmp_path, parts):
    arrays, about = parts
    for name, array in arrays.items():
        refused_avatar(tmp_path, {k: a for k, a in arrays.items() if k != name}, about, name)
        refused_avatar(tmp_path, {**arrays, name: array[:-1]}, about, name)
        refused_avatar(tmp_path, {**arrays, name: array.astype(np.int64)}, about, name, "I64")
        if array.dtype in (np.float16, np.float32):
            bad = array.copy()
            bad.reshape(-1)[-1] = np.nan
            refused_avatar(tmp_path, {**arrays, name: bad}, about)
    refused_avatar(tmp_path, {**arrays, "payload": np.zeros(3)}, about, "payload")


def test_a_description_without_a_field_or_with_nonsense_in_it_is_refused(tmp_path, parts):
    arrays, about = parts
    for text in ("", "{", "[]", "null", "[" * 20_000, '{"format_version": 1e999}', "NaN"):
        refused_avatar(tmp_path, arrays, text)
    for field in ("name", "template", "handedness", "joint_names", "swing", "scale_mode", "storage", "gaussians"):
        refused_avatar(tmp_path, arrays, {name: value for name, value in about.items() if name != field})
        refused_avatar(tmp_path, arrays, {**about, field: None})
    refused_avatar(tmp_path, arrays, {**about, "gaussians": 10**12})
    learned = about.get("learnt") or {}
    for field in set(learned) - {"shadow", "baked", "light"}:
        for value in ({}, -1, "no", 10**12):
            refused_avatar(tmp_path, arrays, {**about, "learnt": {**learned, field: value}})


@pytest.mark.parametrize("parts", ["trained avatar", "avatar in known light"], indirect=True)
def test_a_hand_of_a_kind_of_light_that_nobody_knows_is_refused_by_its_name(tmp_path, parts):
    arrays, about = parts
    light = {**about["learnt"].get("light", {}), "kind": "guessed"}
    changed = {**about, "learnt": {**about["learnt"], "light": light}}
    refused_avatar(tmp_path, arrays, changed, "light kind", "known or estimated", "'guessed'")


# ---- motions ---------------------------------------------------------------------------------------------------------


def header(shape: str) -> bytes:
    """The start of an .npy file that promises `shape`, without the numbers."""
    text = f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}".encode()
    text += b" " * (-(len(text) + 11) % 64) + b"\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


@pytest.mark.parametrize("shape", ["(1000000000000, 21, 3)", "(-1, 21, 3)", "(2, 21, 3, 10**9)"])
def test_headers_that_promise_too_much_are_refused(tmp_path, shape):
    plain, packed = tmp_path / "motion.npy", tmp_path / "motion.npz"
    plain.write_bytes(header(shape))
    with zipfile.ZipFile(packed, "w") as archive:
        archive.writestr("joints_m.npy", header(shape))
    for path, says in ((plain, "undamaged"), (packed, "a whole")):
        with pytest.raises(InputError, match=says):
            read_motion_file(path, TOLD)


HEAD = (
    "HIERARCHY\nROOT RightHand\n{\nOFFSET 0 0 0\nCHANNELS 3 Xrotation Yrotation Zrotation\n"
    "End Site\n{\nOFFSET 0 1 0\n}\n}\n"
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (HEAD + "MOTION\nFrames: 900000\nFrame Time: 0.033\n1 2 3\n", "1 there"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: nan\n1 2 3\n", "frame time"),
        (HEAD + "MOTION\nFrames: 2\nFrame Time: 0.033\n1 2 3\n1 2\n", "frame 1 has not the 3 numbers"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: 0.033\n1 nan 3\n", "no finite numbers"),
        (HEAD + "MOTION\nFrames: 1\nFrame Time: 0.033\n1 2 3\n", "a hand"),
        (HEAD.replace("3 X", "4 X"), "CHANNELS"),
        (HEAD + "}\n", "brace too many"),
        ("Kaydara FBX Binary  \0\x1a\0", "FBX.*Blender"),
        ("BLENDER-v405", "blend"),
        ('{"asset": {"version": "2.0"}, "nodes": []}', "glTF is not read"),
        ('{"joints": [[[1e999, 1, 1]]]}', "motion"),
        (json.dumps({"joints": [[[10**400] * 3] * 21]}), "motion"),
        ("  \n ", "empty"),
    ],
)
def test_what_is_no_motion_says_what_is_wrong(tmp_path, text, says):
    path = tmp_path / "motion.any"
    path.write_text(text)
    with pytest.raises(InputError, match=says) as caught:
        read_motion_file(path, TOLD)
    assert len(str(caught.value)) < 700


def test_a_folder_of_something_else_is_refused(tmp_path):
    (tmp_path / "a.txt").write_text("x")
    with pytest.raises(InputError, match="OpenPose"):
        read_motion_file(tmp_path, TOLD)
    with pytest.raises(InputError, match="absent"):
        read_motion_file(tmp_path / "absent.bvh", TOLD)
    for number in (1, 10**12):
        (tmp_path / f"v_{number:012d}_keypoints.json").write_text('{"people": []}')
    with pytest.raises(InputError, match="frames from 1 to"):
        read_motion_file(tmp_path, TOLD)


# ---- pictures to learn from ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def interhand(tmp_path_factory) -> Path:
    return write_set(tmp_path_factory.mktemp("interhand"), recorded(frames=1))


@pytest.mark.parametrize("name", ["../../../../etc/passwd", "/etc/passwd", "C:/a/b/c/d.png", "..\\..\\x\\y.png"])
def test_no_picture_outside_the_set_is_read(interhand, tmp_path, name):
    folder = shutil.copytree(interhand, tmp_path / "set")
    with edited(folder, "data") as annotations:
        annotations["images"][0]["file_name"] = name
    with pytest.raises(InputError, match=r"annotation 0 in .*file_name"):
        open_capture(folder)


# ---- films -----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def film(tmp_path_factory) -> Path:
    pytest.importorskip("imageio_ffmpeg", reason="the extra `video` is not installed")
    path = tmp_path_factory.mktemp("film") / "film.mp4"
    KINDS["film"].sound(path)
    return path


def converted(film: Path, path: Path, *words: str) -> Path:
    command = [ffmpeg_program(), "-loglevel", "error", "-i", str(film), *words, str(path)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return path


def refused_film(path: Path, match: str) -> None:
    with pytest.raises(InputError, match=match) as told:
        list(read_frames(open_video(path)))
    assert len(str(told.value)) < 600
    assert "\n" not in str(told.value)


def test_what_is_no_film_is_named_and_a_list_of_files_is_not_followed(film, tmp_path):
    refused_film(tmp_path / "none.mp4", "cannot read video")
    refused_film(tmp_path, "a folder")
    path = tmp_path / "list.mp4"
    for text in (
        f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\n{film}\n#EXT-X-ENDLIST\n",
        f"ffconcat version 1.0\nfile '{film}'\n",
    ):
        path.write_text(text)
        refused_film(path, "a film that ffmpeg can read")


def test_absurd_sizes_and_shapes_are_refused_before_a_picture_is_decoded(film, tmp_path, monkeypatch):
    for width, height in ((512, 16), (16, 512)):
        write_video(tmp_path / "thin.mp4", (np.zeros((height, width, 3), np.uint8) for _ in range(3)), 30)
        refused_film(tmp_path / "thin.mp4", "5 times as long as wide")
    shape = converted(film, tmp_path / "shape.mp4", "-vf", "setsar=1/20", "-c:v", "libx264")
    refused_film(shape, "5 times as long as wide")
    monkeypatch.setattr(video, "VIDEO_EDGE_MAX_PX", 60)
    refused_film(film, "64 x 48")


def test_too_many_pictures(film, tmp_path, monkeypatch):
    monkeypatch.setattr(video, "TRACK_FRAMES_MAX", 5)
    refused_film(film, "at most 5 pictures")
    assert len(list(read_frames(open_video(film, most=4), most=4))) == 4, "its beginning can be had"
    # a film that does not say how many it has
    raw = converted(film, tmp_path / "raw.h264", "-c", "copy")
    monkeypatch.setattr(video, "TRACK_FRAMES_MAX", 4)
    notes: list[str] = []
    assert len(list(read_frames(open_video(raw), notes))) == 4
    assert "more than 4 pictures: its first 4 were read" in notes[0]
    notes = []
    assert len(list(read_frames(open_video(raw, most=3), notes, most=3))) == 3
    assert notes == []
