"""Which format a motion file is, by what stands in it; its suffix decides nothing."""

from __future__ import annotations

from pathlib import Path

from jghand_engine.motion import bvh, files, freemocap, interhand, mediapipe, openpose, tables, usd, webxr
from jghand_engine.motion.content import NoMotionError, Reader, Source, json_content

# bytes from which the format of a file is recognized
RECOGNIZE_BYTES = 1 << 16
# the first that recognizes a file reads it: those that know a name or a mark come before those that take what is left
READERS = (
    *(openpose.READER, freemocap.READER, usd.READER, files.ARRAY, files.ARCHIVE, bvh.READER),
    *(files.OBJECT, webxr.RECORDING, interhand.READER, mediapipe.READER, files.LISTS, webxr.READER, tables.READER),
)
_SKELETONS = "export BVH or USD from a program that reads it, such as Blender"
# how files begin that are not read, and what to do
_NOT_READ = {
    b"Kaydara FBX Binary": f"FBX is not read: {_SKELETONS}",
    b"; FBX": f"FBX is not read: {_SKELETONS}",
    b"glTF": f"glTF is not read: {_SKELETONS}",
    b"#VRML": f"VRML is not read: {_SKELETONS}",
    b"BLENDER": "a .blend file is not read: export BVH or USD from it",
}


def recognized(path: Path) -> tuple[Reader, Source]:
    """What reads a file or a folder, and what it reads. OSError; NoMotionError says what else it is, or that nobody
    knows."""
    source = _source(path)
    reader = next((reader for reader in READERS if reader.recognizes(source)), None)
    if reader is not None:
        return reader, source
    if path.is_dir():
        raise NoMotionError(
            "a folder with neither frames of OpenPose nor hands of FreeMoCap; pictures to learn from are no motion"
        )
    if isinstance(source.document, dict) and "asset" in source.document:
        raise NoMotionError(_NOT_READ[b"glTF"])
    if source.document is not None:
        raise NoMotionError("JSON in which JGHand finds no frames of hands")
    raise NoMotionError("its beginning is that of no motion file that JGHand knows; hands in a video are tracked")


def _source(path: Path) -> Source:
    if path.is_dir():
        return Source(path)
    with open(path, "rb") as stream:
        head = stream.read(RECOGNIZE_BYTES)
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if not text:
        raise NoMotionError("it is empty")
    for mark, advice in _NOT_READ.items():
        if head.startswith(mark):
            raise NoMotionError(advice)
    is_json = text[:1] in (b"{", b"[")
    return Source(path, text, json_content(path) if is_json else None)
