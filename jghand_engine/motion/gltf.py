"""Skeletons of glTF 2.0 that move: .glb, and .gltf with its buffers inside or beside it.

Joints are nodes, found by their names whether or not a skin uses them. Every channel is taken at its own interpolation
(STEP, LINEAR with rotations along great circles, CUBICSPLINE); glTF's units are meters and y is up. Of several
animations the one that turns most of the hands' bones is taken, and that is said. Nothing else of the file is looked
at: meshes and materials may be anything.
"""

from __future__ import annotations

import base64
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np

from jghand_engine.hand.rotations import slerp
from jghand_engine.motion.bone_names import hands_among
from jghand_engine.motion.choose import named
from jghand_engine.motion.clocks import frame_times, key_frames
from jghand_engine.motion.content import MotionContent
from jghand_engine.motion.files import MotionFormat
from jghand_engine.motion.skeleton import hand_tracks, in_world, rotation_matrices, with_ancestors

MAGIC, _VERSION, _JSON_CHUNK, _BINARY_CHUNK = b"glTF", 2, 0x4E4F534A, 0x004E4942
# component type -> of numbers, and what whole ones stand for 1
_COMPONENTS = {5126: ("<f4", 1), 5121: ("u1", 255), 5123: ("<u2", 65535), 5120: ("i1", 127), 5122: ("<i2", 32767)}
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
# the description in a GLB, bytes: a rig with meshes, materials and some actions has some hundred kB
_DESCRIPTION_MAX_BYTES = 1 << 26
# part of the way to the next key by which a frame may miss it: times are stored in single precision
_KEY_EPS = 1e-3
# what a node has where it says nothing
_STILL = {"translation": (0.0, 0.0, 0.0), "rotation": (0.0, 0.0, 0.0, 1.0), "scale": (1.0, 1.0, 1.0)}


@dataclass(frozen=True)
class _Channel:
    """times_s: (K,) rising · values: (K, width), or (K, 3, width) for CUBICSPLINE: tangent in, value, tangent out."""

    interpolation: str
    times_s: np.ndarray
    values: np.ndarray


def read(file: Path, document: Mapping[str, Any] | None, wanted: MotionFormat) -> MotionContent:
    """The hands of a glTF file at the wanted rate, else at that of its keys; wanted.part may name the animation.

    document: that of a .gltf, None for a .glb. ValueError says what is wrong.
    """
    content = _Document(file, document)
    skeleton = _Gltf(content, wanted)
    tracks, lacking = hand_tracks(skeleton, "", wanted.bones)
    return MotionContent(
        "glTF", tuple(tracks), 1.0, fps=skeleton.fps, notes=(*skeleton.notes, *lacking), up="y", is_skeleton=True,
        files=(file, *content.beside), animations=skeleton.animations,
    )  # fmt: skip


class _Gltf:
    """Nodes as a skeleton, at even times."""

    def __init__(self, document: _Document, wanted: MotionFormat) -> None:
        nodes = _objects(document.about, "nodes")
        self.names = tuple(str(node.get("name", f"node {place}")) for place, node in enumerate(nodes))
        self.ends: dict[int, np.ndarray] = {}
        self._parents = _parents(document, nodes)
        hands = hands_among(self.names, wanted.bones)[0]
        bones = {bone for hand in hands for bone in hand.bones if bone is not None}
        self._kept = with_ancestors(bones, self._parents)
        self._still = {
            node: {path: _vector(nodes[node].get(path, still), len(still)) for path, still in _STILL.items()}
            for node in self._kept
        }
        # columns one after the other
        self._matrices = {
            node: _vector(nodes[node]["matrix"], 16).reshape(4, 4).T for node in self._kept if "matrix" in nodes[node]
        }
        self._channels, self.animations, self.notes = _channels(document, set(self._kept), wanted.part)
        # times in single precision, of which the same ones stand in every channel
        keys_s = np.unique(np.concatenate([np.zeros(0), *(channel.times_s for channel in self._channels.values())]))
        self.fps, said = (wanted.fps, []) if wanted.fps is not None else key_frames(keys_s)
        self.notes += said
        self._times_s = frame_times(keys_s, self.fps)
        self.rest = np.tile(np.eye(4), (len(nodes), 1, 1))
        at_rest = in_world(self._kept, self._parents, lambda node: self._local(node, None))
        for node, world in at_rest.items():
            self.rest[node] = world

    @property
    def frame_count(self) -> int:
        return len(self._times_s)

    def world(self, joints: list[int], first: int, last: int) -> np.ndarray:
        """See AnimatedSkeleton."""
        times_s = self._times_s[first:last]
        world = in_world(self._kept, self._parents, lambda node: self._local(node, times_s))
        return np.stack([np.broadcast_to(world[joint], (len(times_s), 4, 4)) for joint in joints], axis=1)

    def _local(self, node: int, times_s: np.ndarray | None) -> np.ndarray:
        """(4, 4), or (F, 4, 4) of a node that moves, in its parent's frame. None: at rest."""
        moving = {} if times_s is None else {
            path: _sampled(self._channels[node, path], path, times_s)
            for path in _STILL if (node, path) in self._channels
        }  # fmt: skip
        if not moving and node in self._matrices:
            return self._matrices[node]
        at = self._still[node] | moving
        result = np.zeros((*np.broadcast_shapes(*(value.shape[:-1] for value in at.values())), 4, 4))
        result[..., :3, :3] = rotation_matrices(at["rotation"]) * at["scale"][..., None, :]
        result[..., :3, 3] = at["translation"]
        result[..., 3, 3] = 1.0
        return result


def _sampled(channel: _Channel, path: str, times_s: np.ndarray) -> np.ndarray:
    """(F, width) at some times, held before the first key and after the last."""
    keys, values = channel.times_s, channel.values
    after = np.clip(np.searchsorted(keys, times_s, side="right"), min(1, len(keys) - 1), len(keys) - 1)
    before = np.maximum(after - 1, 0)
    step = np.where(after > before, keys[after] - keys[before], 1.0)
    part = np.clip((times_s - keys[before]) / step, 0.0, 1.0)
    if channel.interpolation == "STEP":
        return values[np.where(part >= 1 - _KEY_EPS, after, before)]
    if channel.interpolation == "CUBICSPLINE":
        # the Hermite spline of glTF's appendix C
        t, step = part[:, None], step[:, None]
        return (
            (2 * t**3 - 3 * t**2 + 1) * values[before, 1]
            + (t**3 - 2 * t**2 + t) * step * values[before, 2]
            + (3 * t**2 - 2 * t**3) * values[after, 1]
            + (t**3 - t**2) * step * values[after, 0]
        )
    start, end = values[before], values[after]
    if path != "rotation":
        return start * (1 - part[:, None]) + end * part[:, None]
    lengths = np.linalg.norm(values, axis=-1)
    if not (lengths > 0).all():
        raise ValueError("a rotation that is no quaternion")
    # the short way
    end = np.where((start * end).sum(-1, keepdims=True) < 0, -end, end)
    a, b = start / lengths[before, None], end / lengths[after, None]
    return slerp(a, b, part)


# ---- the document ---------------------------------------------------------------------------------------------------


class _Document:
    """What a glTF file says, and its numbers. beside: files beside it that were read."""

    def __init__(self, file: Path, about: Mapping[str, Any] | None) -> None:
        self._folder, self._binary = file.parent, None
        if about is None:
            text, self._binary = _glb_chunks(_mapped(file))
            about = json.loads(bytes(text))
        self.about: Mapping[str, Any] = about if isinstance(about, Mapping) else {}
        self._buffers: dict[int, memoryview] = {}
        self.beside: list[Path] = []

    def values(self, index: Any, width: int) -> np.ndarray:
        """(N, width) float64 of an accessor. ValueError when its bytes are not there."""
        accessor = _entry(self.about, "accessors", index)
        if "sparse" in accessor or accessor.get("type") != _TYPES[width]:
            raise ValueError(f"a sparse accessor, or one of type {str(accessor.get('type'))[:40]!r}")
        dtype, one = _COMPONENTS[accessor["componentType"]]
        view = _entry(self.about, "bufferViews", accessor.get("bufferView"))
        binary, each = self._buffer(view.get("buffer")), np.dtype(dtype).itemsize
        count, stride = accessor["count"], view.get("byteStride", each * width)
        start, size, inner = view.get("byteOffset", 0), view.get("byteLength", 0), accessor.get("byteOffset", 0)
        if not count > 0 or min(start, inner) < 0 or stride < each * width:
            raise ValueError(f"an accessor with a count of {count}")
        if start + size > len(binary) or inner + (count - 1) * stride + each * width > size:
            raise ValueError(f"an accessor of {count} rows beyond its bytes")
        rows = np.ndarray((count, width), dtype, binary, start + inner, (stride, each)).astype(np.float64)
        if not np.isfinite(rows).all():
            raise ValueError("keys that are no finite numbers")
        return np.maximum(rows / one, -1.0) if one > 1 else rows

    def _buffer(self, index: Any) -> memoryview:
        uri = _entry(self.about, "buffers", index).get("uri")
        if index not in self._buffers:
            content = self._binary if uri is None else self._loaded(str(uri))
            if content is None:
                raise ValueError("no binary chunk")
            self._buffers[index] = content
        return self._buffers[index]

    def _loaded(self, uri: str) -> memoryview:
        if uri.startswith("data:"):
            return memoryview(base64.b64decode(uri.partition(",")[2], validate=True))
        path = PurePosixPath(unquote(uri))
        if path.is_absolute() or ".." in path.parts or ":" in uri or "\\" in uri:
            raise ValueError(f"a buffer outside of the file's folder: {uri[:80]}")
        self.beside.append(self._folder / path)
        return _mapped(self.beside[-1])


def _glb_chunks(content: memoryview) -> tuple[memoryview, memoryview | None]:
    """The description of a .glb, JSON, and its binary chunk, None where it has none. ValueError"""
    magic, version, total, text_bytes, kind = struct.unpack_from("<4sIIII", content)
    if (magic, version, kind) != (MAGIC, _VERSION, _JSON_CHUNK):
        raise ValueError("another beginning than that of glTF 2.0")
    if total != len(content) or text_bytes > min(_DESCRIPTION_MAX_BYTES, total - 20):
        raise ValueError(f"{len(content)} bytes where its header says {total}, {text_bytes} of them a description")
    text, rest = content[20 : 20 + text_bytes], content[20 + text_bytes :]
    if len(rest) < 8:
        return text, None
    binary_bytes, kind = struct.unpack_from("<II", rest)
    if kind != _BINARY_CHUNK or binary_bytes > len(rest) - 8:
        raise ValueError(f"a binary chunk of {binary_bytes} bytes in a file of {len(content)}")
    return text, rest[8 : 8 + binary_bytes]


def _entry(about: Mapping[str, Any], name: str, index: Any) -> dict[str, Any]:
    """The entry of a number in a list of the file. ValueError"""
    entries = about.get(name, [])
    if not isinstance(index, int) or not 0 <= index < len(entries) or not isinstance(entries[index], dict):
        raise ValueError(f"no {name} of number {str(index)[:40]}")
    return entries[index]


def _objects(about: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """A list of objects, [] where there is none. ValueError"""
    entries = about.get(name, [])
    if not isinstance(entries, list) or not all(isinstance(one, dict) for one in entries):
        raise ValueError(f"{name} that are no list of objects")
    return entries


def _mapped(file: Path) -> memoryview:
    with open(file, "rb") as stream:
        return memoryview(mmap(stream.fileno(), 0, access=ACCESS_READ))


def _parents(document: _Document, nodes: list[dict[str, Any]]) -> list[int]:
    """The node above each, -1 for none. ValueError for a node below two, and for numbers of none."""
    parents = [-1] * len(nodes)
    for place, entry in enumerate(nodes):
        for child in entry.get("children", ()):
            _entry(document.about, "nodes", child)
            if parents[child] >= 0 or child == place:
                raise ValueError("a node with two parents")
            parents[child] = place
    return parents


def _vector(values: Any, size: int) -> np.ndarray:
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise ValueError(f"{size} numbers of a node wanted, found {str(values)[:60]}")
    return vector


def _channels(
    document: _Document, kept: set[int], part: str | None
) -> tuple[dict[tuple[int, str], _Channel], tuple[str, ...], list[str]]:
    """The channels of one animation that move the kept nodes, by node and path, the names of all animations that do,
    and what is to be said about the choice."""
    moving = []
    for number, animation in enumerate(_objects(document.about, "animations")):
        targets = [(entry.get("target", {}), entry.get("sampler")) for entry in _objects(animation, "channels")]
        touched = [one for one in targets if one[0].get("node") in kept and one[0].get("path") in _STILL]
        if touched:
            moving.append((str(animation.get("name", f"animation {number}")), animation, touched))
    names = tuple(name for name, _, _ in moving)
    if part is not None and (chosen := named(part, names)):
        moving = [moving[place] for place in chosen]
    if not moving:
        return {}, names, ["No animation moves its hands: its pose is one frame."] if kept else []
    name, animation, touched = max(moving, key=lambda one: len(one[2]))
    notes = []
    if len(moving) > 1:
        others = ", ".join(other for other, _, _ in moving if other != name)[:200]
        notes.append(f"Of its {len(moving)} animations '{name}' was taken; --part chooses another: {others}.")
    return {
        (target["node"], target["path"]): _channel(document, _entry(animation, "samplers", sampler), target["path"])
        for target, sampler in touched
    }, names, notes  # fmt: skip


def _channel(document: _Document, sampler: dict[str, Any], path: str) -> _Channel:
    interpolation = str(sampler.get("interpolation", "LINEAR"))
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise ValueError(f"interpolation {interpolation[:40]}")
    times_s = document.values(sampler.get("input"), 1)[:, 0]
    values = document.values(sampler.get("output"), len(_STILL[path]))
    rows = 3 if interpolation == "CUBICSPLINE" else 1
    if len(values) != rows * len(times_s) or (np.diff(times_s) <= 0).any():
        raise ValueError("keys whose times do not rise, or without a value each")
    return _Channel(interpolation, times_s, values.reshape(len(times_s), 3, -1) if rows == 3 else values)
