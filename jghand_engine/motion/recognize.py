"""Which format a motion file is, by what stands in it; its suffix only decides where content does not."""

from __future__ import annotations

import zipfile
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

from numpy.lib.format import MAGIC_PREFIX

from jghand_engine.motion import (
    bvh,
    files,
    freemocap,
    freemocap_lines,
    gltf,
    interhand,
    mediapipe,
    openpose,
    tables,
    usd,
    webxr,
)
from jghand_engine.motion.content import MotionContent, NoMotionError, json_content
from jghand_engine.motion.files import MotionFormat

# bytes from which the format of a file is recognized
RECOGNIZE_BYTES = 1 << 16
# frames in which a hand is looked for before a file is given up: it may not be there from the beginning
RECOGNIZE_FRAMES = 5000
_FRAME_LISTS = ("frames", "data", "samples", "recording", "results", "poses", "animation", "motion")
_NOT_READ = {
    b"Kaydara FBX Binary": "FBX",
    b"; FBX": "FBX",
    b"#VRML": "VRML",
    b"BLENDER": "a .blend file",
}
_NO_FRAMES = "JSON in which JGHand finds no frames of hands"
Reader = Callable[[], MotionContent]


def reader_of(file: Path, wanted: MotionFormat) -> Reader:
    """What reads a file or a folder. OSError; ValueError says what else it is, or that nobody knows."""
    if file.is_dir():
        return _of_folder(file)
    with open(file, "rb") as stream:
        head = stream.read(RECOGNIZE_BYTES)
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if not text:
        raise NoMotionError("it is empty")
    for mark, name in _NOT_READ.items():
        if head.startswith(mark):
            raise NoMotionError(
                f"{name} is not read: export BVH, glTF or USD from a program that reads it, such as Blender"
            )
    if head.startswith(MAGIC_PREFIX):
        is_recording = freemocap.is_array(file)
        return partial(freemocap.read, [file]) if is_recording else partial(files.read_content, file, ".npy")
    if head.startswith((usd.CRATE, usd.TEXT)) or (head.startswith(b"PK\x03\x04") and _holds_usd(file)):
        return partial(usd.read, file, wanted.fps, wanted.bones)
    if head.startswith(b"PK\x03\x04"):
        return partial(files.read_content, file, ".npz")
    if head.startswith(gltf.MAGIC):
        return partial(gltf.read, file, None, wanted)
    if text[:9].upper() == b"HIERARCHY":
        return partial(bvh.read, file, wanted.bones, wanted.up)
    if text[:1] in (b"{", b"["):
        return _of_json(file, json_content(file), wanted)
    if b"\x00" in head:
        raise NoMotionError(
            "its beginning is that of no motion file that JGHand knows (hands in a video: `jghand track`)"
        )
    return _of_table(file)


def _of_folder(folder: Path) -> Reader:
    if next(folder.glob(f"*{openpose.SUFFIX}"), None) is not None:
        return partial(openpose.read_folder, folder)
    recording = freemocap.files_of(folder)
    if recording:
        return partial(freemocap.read, recording)
    raise NoMotionError(
        "a folder with neither frames of OpenPose nor hands of FreeMoCap (pictures to learn from: `jghand check-data`)"
    )


def _holds_usd(file: Path) -> bool:
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
    except zipfile.BadZipFile as error:
        raise ValueError(f"a damaged archive: {error}") from error
    return bool(names) and names[0].casefold().endswith((".usda", ".usdc", ".usd"))


def _of_json(file: Path, content: Any, wanted: MotionFormat) -> Reader:
    """By the names of the outermost object, then by the first frames that say anything."""
    own = partial(files.read_content, file, ".json", content)
    about = content if isinstance(content, dict) else {}
    joints = about.get("joints")
    # one pose of a headset, of points {"x": …}, is none of our own files
    if isinstance(joints, list) and not (joints and isinstance(joints[0], Mapping)):
        return own
    if isinstance(about.get("asset"), Mapping) and "version" in about["asset"]:
        return partial(gltf.read, file, about, wanted)
    if "schema" in about and isinstance(about.get("frames"), list):
        return partial(webxr.read_iwer, about["schema"], about["frames"])
    if "people" in about:
        return partial(openpose.read, [content])
    if interhand.looks_like(about):
        return partial(interhand.read, about)
    lists = {name.casefold(): value for name, value in about.items() if isinstance(value, list)}
    listed = (
        content if isinstance(content, list) else next((lists[name] for name in _FRAME_LISTS if name in lists), None)
    )
    fps = about.get("fps")
    fps = float(fps) if isinstance(fps, int | float) and not isinstance(fps, bool) else None
    for frame in [about] if listed is None else listed[:RECOGNIZE_FRAMES]:
        if mediapipe.looks_like(frame):
            return partial(mediapipe.read, [about] if listed is None else listed, fps, wanted.mirrored_labels)
        if openpose.looks_like(frame):
            return partial(openpose.read, listed or [])
        if listed is content and _is_list_of_points(frame):
            return own
        if webxr.looks_like(frame):
            return partial(webxr.read, [about] if listed is None else listed, fps)
    if listed is content:
        return own
    raise NoMotionError(_NO_FRAMES)


def _is_list_of_points(frame: Any) -> bool:
    """Whether a frame is joints alone, [[x, y, z], null, …]."""
    return isinstance(frame, list) and bool(frame) and (frame[0] is None or isinstance(frame[0], list))


def _of_table(file: Path) -> Reader:
    """CSV: our own, FreeMoCap's, or one whose columns are named after joints in another way."""
    # more than the head: its last cell may be half a number
    cells = tables.header_in(file)
    if freemocap_lines.looks_like(cells):
        return partial(freemocap.read, [file])
    if len(cells) < 3:
        raise NoMotionError("its beginning is that of no motion file that JGHand knows")
    if files.has_own_columns(cells) or not tables.named_hands(cells)[0]:
        return partial(files.read_content, file, ".csv")
    return partial(freemocap.read, [file]) if freemocap.is_table(file, cells) else partial(tables.read, file)
