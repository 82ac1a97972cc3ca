"""Which format a motion file is, by what stands in it; its suffix only decides where content does not."""

from __future__ import annotations

import itertools
import zipfile
from enum import StrEnum
from pathlib import Path

from numpy.lib.format import MAGIC_PREFIX

from jghand_engine import limits
from jghand_engine.motion.files import has_own_columns
from jghand_engine.motion.foreign import freemocap, gltf, interhand, joint_lines, mediapipe, openpose, webxr
from jghand_engine.motion.foreign.damage import NoMotionError
from jghand_engine.motion.foreign.json_text import JsonText
from jghand_engine.motion.foreign.tables import header_in, named_hands

FRAME_LISTS = ("frames", "data", "samples", "recording", "results", "poses", "animation", "motion")
_USD_TEXT, _USD_CRATE = b"#usda", b"PXR-USDC"
_NOT_READ = {
    b"Kaydara FBX Binary": "FBX",
    b"; FBX": "FBX",
    b"#VRML": "VRML",
    b"BLENDER": "a .blend file",
}


class Kind(StrEnum):
    """A format, as its reader calls it."""

    OWN_NPZ = ".npz"
    OWN_NPY = ".npy"
    OWN_JSON = ".json"
    OWN_CSV = ".csv"
    BVH = "bvh"
    GLTF = "gltf"
    USD = "usd"
    OPENPOSE = "openpose"
    OPENPOSE_FOLDER = "openpose folder"
    MEDIAPIPE = "mediapipe"
    WEBXR = "webxr"
    IWER = "iwer"
    INTERHAND = "interhand"
    FREEMOCAP = "freemocap"
    FREEMOCAP_FOLDER = "freemocap folder"
    TABLE = "table"


def kind_of(file: Path) -> Kind:
    """The format of a file or a folder. OSError; ValueError says what else it is, or that nobody knows."""
    if file.is_dir():
        return _of_folder(file)
    with open(file, "rb") as stream:
        head = stream.read(limits.RECOGNIZE_BYTES)
    if not head.strip():
        raise NoMotionError("it is empty")
    for mark, name in _NOT_READ.items():
        if head.startswith(mark):
            raise NoMotionError(
                f"{name} is not read: export BVH, glTF or USD from a program that reads it, such as Blender"
            )
    if head.startswith(MAGIC_PREFIX):
        return Kind.FREEMOCAP if freemocap.is_array(file) else Kind.OWN_NPY
    if head.startswith(b"PK\x03\x04"):
        return _of_archive(file)
    if head.startswith(gltf.MAGIC):
        return Kind.GLTF
    if head.startswith((_USD_CRATE, _USD_TEXT)):
        return Kind.USD
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if text[:9].upper() == b"HIERARCHY":
        return Kind.BVH
    if text[:1] in (b"{", b"["):
        return _of_json(file)
    if b"\x00" in head:
        raise NoMotionError(
            "its beginning is that of no motion file that JGHand knows (hands in a video: `jghand track`)"
        )
    return _of_table(file)


def frames_place(text: JsonText) -> int | None:
    """Where the list of frames in a JSON file begins: the file itself, or the first member of such a name."""
    if text.text[text.start] == "[":
        return text.start
    found = {name.casefold(): place for name, place in text.names.items() if text.text[place] == "["}
    return next((found[name] for name in FRAME_LISTS if name in found), None)


def _of_folder(folder: Path) -> Kind:
    if next(folder.glob(f"*{openpose.SUFFIX}"), None) is not None:
        return Kind.OPENPOSE_FOLDER
    if freemocap.files_of(folder):
        return Kind.FREEMOCAP_FOLDER
    raise NoMotionError(
        "a folder with neither frames of OpenPose nor hands of FreeMoCap (pictures to learn from: `jghand check-data`)"
    )


def _of_archive(file: Path) -> Kind:
    try:
        with zipfile.ZipFile(file) as archive:
            names = archive.namelist()
    except zipfile.BadZipFile as error:
        raise ValueError(f"a damaged archive: {error}") from error
    if names and names[0].casefold().endswith((".usda", ".usdc", ".usd")):
        return Kind.USD
    return Kind.OWN_NPZ


def _of_json(file: Path) -> Kind:
    text = JsonText.of_file(file)
    if text.text[text.start] == "{":
        names = text.names
        if "joints" in names and text.text[names["joints"]] == "[" and _has_frames(text, names["joints"]):
            return Kind.OWN_JSON
        if gltf.looks_like(text):
            return Kind.GLTF
        if "schema" in names and "frames" in names:
            return Kind.IWER
        if "people" in names:
            return Kind.OPENPOSE
    place = frames_place(text)
    if place is not None:
        return _of_frames(text, place)
    whole = text.value(text.start) if len(text.text) <= limits.JSON_ELEMENT_MAX_BYTES else None
    if mediapipe.looks_like(whole):
        return Kind.MEDIAPIPE
    if interhand.looks_like(text):
        return Kind.INTERHAND
    if webxr.looks_like(whole):
        return Kind.WEBXR
    raise NoMotionError("JSON in which JGHand finds no frames of hands")


def _has_frames(text: JsonText, place: int) -> bool:
    """Whether a list of joints is ours, of frames, and not one pose of a headset, of points {"x": …}."""
    return not isinstance(next(text.elements(place), None), dict)


def _of_frames(text: JsonText, place: int) -> Kind:
    """By the first frames that say anything: a hand may not be there from the beginning."""
    for frame in itertools.islice(text.elements(place), limits.RECOGNIZE_JSON_FRAMES):
        if mediapipe.looks_like(frame):
            return Kind.MEDIAPIPE
        if openpose.looks_like(frame):
            return Kind.OPENPOSE
        if place == text.start and _is_list_of_points(frame):
            return Kind.OWN_JSON
        if webxr.looks_like(frame):
            return Kind.WEBXR
    if place == text.start:
        return Kind.OWN_JSON
    raise NoMotionError("JSON in which JGHand finds no frames of hands")


def _is_list_of_points(frame: object) -> bool:
    """Whether a frame is joints alone, [[x, y, z], null, …]."""
    return isinstance(frame, list) and bool(frame) and (frame[0] is None or isinstance(frame[0], list))


def _of_table(file: Path) -> Kind:
    """CSV: our own, FreeMoCap's, or one whose columns are named after joints in another way."""
    # more than the head: its last cell may be half a number
    cells = header_in(file)
    if joint_lines.looks_like(cells):
        return Kind.FREEMOCAP
    if len(cells) < 3:
        raise NoMotionError("its beginning is that of no motion file that JGHand knows")
    if has_own_columns(cells) or not named_hands(cells)[0]:
        return Kind.OWN_CSV
    return Kind.FREEMOCAP if freemocap.is_table(file, cells) else Kind.TABLE
