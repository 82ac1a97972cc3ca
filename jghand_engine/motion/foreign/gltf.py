"""Skeletons of glTF 2.0 that move: .glb, and .gltf with its buffers inside or beside it.

Joints are nodes, found by their names whether or not a skin uses them. Every channel is taken at its own interpolation
(STEP, LINEAR with rotations along great circles, CUBICSPLINE); glTF's units are meters and y is up. Of several
animations the one that turns most of the hands' bones is taken, and that is said. Nothing else of the file is looked
at: meshes and materials may be anything.
"""

from __future__ import annotations

import base64
import binascii
import math
from dataclasses import dataclass
from mmap import ACCESS_READ, mmap
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from jghand_engine import limits
from jghand_engine.hand.rotations import slerp
from jghand_engine.motion.foreign.bone_names import BoneMap, hands_among
from jghand_engine.motion.foreign.clocks import frame_times, key_frames
from jghand_engine.motion.foreign.content import MotionContent, named
from jghand_engine.motion.foreign.json_text import JsonText
from jghand_engine.motion.foreign.skeleton import check_depth, down, hand_tracks
from jghand_engine.motion.gltf_content import MAGIC, accessor_rows, glb_chunks, list_entry, objects

KIND = "glTF"
_LISTS = ("nodes", "animations", "accessors", "bufferViews", "buffers")
_PATHS = {"translation": 3, "rotation": 4, "scale": 3}


@dataclass(frozen=True)
class _Node:
    name: str
    parent: int
    translation: np.ndarray
    rotation_xyzw: np.ndarray
    scale: np.ndarray
    matrix: np.ndarray | None


@dataclass(frozen=True)
class _Channel:
    """times_s: (K,) rising · values: (K, width), or (3 K, width) for CUBICSPLINE: tangent in, value, tangent out."""

    node: int
    path: str
    interpolation: str
    times_s: np.ndarray
    values: np.ndarray


def looks_like(text: JsonText) -> bool:
    """Whether a JSON object is a glTF file."""
    place = text.names.get("asset")
    return place is not None and text.text[place] == "{" and "version" in text.value(place)


def read(file: Path, fps: float | None, part: str | None, bones: BoneMap | None = None) -> MotionContent:
    """The hands of a glTF file at `fps`, else at the rate of its keys. part: of the animation's name, where there are
    several. bones: a map made by hand. ValueError says what is wrong."""
    document = _Document(file)
    nodes = _nodes(document)
    hands, _ = hands_among([node.name for node in nodes], bones)
    wanted = {bone for hand in hands for bone in hand.bones if bone is not None}
    kept = _with_ancestors(nodes, wanted)
    check_depth(kept, wanted)
    channels, moving, notes = _channels(document, set(kept), part)
    skeleton = _Gltf(nodes, kept, channels, fps)
    tracks, lacking = hand_tracks(skeleton, "", bones)
    return MotionContent(
        KIND, tuple(tracks), 1.0, fps=skeleton.fps, notes=(*notes, *skeleton.notes, *lacking), up="y",
        files=(file, *document.beside), animations=moving,
    )  # fmt: skip


class _Gltf:
    """Nodes as a skeleton, at even times."""

    def __init__(self, nodes: list[_Node], kept: list[int], channels: list[_Channel], fps: float | None) -> None:
        self._nodes, self._kept = nodes, kept
        self.names = tuple(node.name for node in nodes)
        self.ends: dict[int, np.ndarray] = {}
        self._of_node = {(channel.node, channel.path): channel for channel in channels}
        # times in single precision, of which the same ones stand in every channel
        keys_s = np.unique(np.concatenate([channel.times_s for channel in channels])) if channels else np.zeros(0)
        self.fps, self.notes = (fps, []) if fps is not None else key_frames(keys_s)
        self._times_s = frame_times(keys_s, self.fps)
        self.rest = self._rest()

    @property
    def frame_count(self) -> int:
        return len(self._times_s)

    def world(self, joints: list[int], first: int, last: int) -> np.ndarray:
        """See AnimatedSkeleton."""
        times_s = self._times_s[first:last]
        result = np.empty((len(times_s), len(joints), 4, 4))
        parents = [self._nodes[place].parent for place in self._kept]
        for place, world in down(self._kept, parents, lambda place: self._local(place, times_s), np.matmul):
            for column in (column for column, joint in enumerate(joints) if joint == place):
                result[:, column] = world
        return result

    def _local(self, place: int, times_s: np.ndarray) -> np.ndarray:
        node = self._nodes[place]
        values = {
            path: _sampled(channel, times_s)
            for path in _PATHS
            if (channel := self._of_node.get((place, path))) is not None
        }
        if not values and node.matrix is not None:
            return np.broadcast_to(node.matrix, (len(times_s), 4, 4))
        translation = values.get("translation", node.translation)
        rotation = values.get("rotation", node.rotation_xyzw)
        return _transforms(len(times_s), translation, rotation, values.get("scale", node.scale))

    def _rest(self) -> np.ndarray:
        rest = np.tile(np.eye(4), (len(self._nodes), 1, 1))
        for place in self._kept:
            node = self._nodes[place]
            local = node.matrix
            if local is None:
                local = _transforms(1, node.translation, node.rotation_xyzw, node.scale)[0]
            rest[place] = local if node.parent < 0 else rest[node.parent] @ local
        return rest


def _transforms(count: int, translation: np.ndarray, rotation_xyzw: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """(F, 4, 4) from (F, 3) or (3,), (F, 4) or (4,), (F, 3) or (3,)."""
    if not (np.linalg.norm(rotation_xyzw, axis=-1) > 0).all():
        raise ValueError("a rotation that is no quaternion")
    result = np.zeros((count, 4, 4))
    turned = Rotation.from_quat(rotation_xyzw).as_matrix()
    result[:, :3, :3] = turned * np.asarray(scale)[..., None, :]
    result[:, :3, 3] = translation
    result[:, 3, 3] = 1.0
    return result


def _sampled(channel: _Channel, times_s: np.ndarray) -> np.ndarray:
    """(F, width) at some times, held before the first key and after the last."""
    keys, values = channel.times_s, channel.values
    if channel.interpolation == "CUBICSPLINE":
        return _spline(keys, values.reshape(len(keys), 3, -1), times_s)
    if len(keys) == 1:
        return np.repeat(values, len(times_s), axis=0)
    after = np.clip(np.searchsorted(keys, times_s, side="right"), 1, len(keys) - 1)
    before = after - 1
    part = np.clip((times_s - keys[before]) / (keys[after] - keys[before]), 0.0, 1.0)
    if channel.interpolation == "STEP":
        # times are stored in single precision: a key that was just missed counts
        return values[np.where(part >= 1 - limits.KEY_EPS, after, before)]
    if channel.path != "rotation":
        return values[before] * (1 - part[:, None]) + values[after] * part[:, None]
    return _slerp(values[before], values[after], part)


def _slerp(first: np.ndarray, second: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Quaternions (F, 4) at `part` (F,) of the short way."""
    second = np.where((first * second).sum(-1, keepdims=True) < 0, -second, second)
    sizes = [np.linalg.norm(one, axis=-1, keepdims=True) for one in (first, second)]
    if not all((size > 0).all() for size in sizes):
        raise ValueError("a rotation that is no quaternion")
    a, b = (torch.from_numpy((one / size).T.copy()) for one, size in zip((first, second), sizes, strict=True))
    return slerp(a, b, torch.from_numpy(part)).numpy().T


def _spline(keys: np.ndarray, values: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """The cubic Hermite spline of glTF's appendix C; values (K, 3, width)."""
    if len(keys) == 1:
        return np.repeat(values[:, 1], len(times_s), axis=0)
    after = np.clip(np.searchsorted(keys, times_s, side="right"), 1, len(keys) - 1)
    before = after - 1
    step = (keys[after] - keys[before])[:, None]
    t = np.clip((times_s[:, None] - keys[before][:, None]) / step, 0.0, 1.0)
    start, end = values[before, 1], values[after, 1]
    leaving, arriving = step * values[before, 2], step * values[after, 0]
    return (
        (2 * t**3 - 3 * t**2 + 1) * start
        + (t**3 - 2 * t**2 + t) * leaving
        + (3 * t**2 - 2 * t**3) * end
        + (t**3 - t**2) * arriving
    )


# ---- the document ---------------------------------------------------------------------------------------------------


class _Document:
    """The lists of a glTF file that a skeleton needs, and its numbers."""

    def __init__(self, file: Path) -> None:
        self._folder = file.parent
        self._binary: memoryview | None = None
        with open(file, "rb") as stream:
            is_binary = stream.read(4) == MAGIC
        text = self._glb(file) if is_binary else JsonText.of_file(file)
        self.lists: dict[str, list[dict[str, Any]]] = {}
        for name, place in text.names.items():
            if name in _LISTS and text.text[place] == "[":
                most = limits.JSON_BUFFER_MAX_BYTES if name == "buffers" else limits.JSON_ELEMENT_MAX_BYTES
                entries: list[dict[str, Any]] = []
                for entry in text.elements(place, most):
                    if not isinstance(entry, dict) or len(entries) >= limits.RIG_PARTS_MAX:
                        raise ValueError(f"{name} that are no objects, or more than {limits.RIG_PARTS_MAX}")
                    entries.append(entry)
                self.lists[name] = entries
        self._buffers: dict[int, memoryview] = {}
        # files beside this one that were read
        self.beside: list[Path] = []

    def values(self, index: Any, width: int) -> np.ndarray:
        """(N, width) float64 of an accessor. ValueError when its bytes are not there."""
        rows, one = accessor_rows(self.lists, index, width, self._buffer)
        array = rows.astype(np.float64)
        if not np.isfinite(array).all():
            raise ValueError("keys that are no finite numbers")
        return np.maximum(array / one, -1.0) if one > 1 else array

    def _glb(self, file: Path) -> JsonText:
        with open(file, "rb") as stream:
            content = memoryview(mmap(stream.fileno(), 0, access=ACCESS_READ))
        text, self._binary = glb_chunks(content, limits.GLTF_JSON_MAX_BYTES)
        return JsonText(bytes(text))

    def _buffer(self, index: Any) -> memoryview:
        buffer = list_entry(self.lists, "buffers", index)
        if index not in self._buffers:
            self._buffers[index] = self._loaded(buffer)
        return self._buffers[index]

    def _loaded(self, buffer: dict[str, Any]) -> memoryview:
        uri = buffer.get("uri")
        if uri is None:
            if self._binary is None:
                raise ValueError("no binary chunk")
            return self._binary
        if not isinstance(uri, str):
            raise ValueError("the address of a buffer that is no text")
        if uri.startswith("data:"):
            try:
                return memoryview(base64.b64decode(uri.partition(",")[2], validate=True))
            except binascii.Error as error:
                raise ValueError("a buffer that is no base64") from error
        path = PurePosixPath(unquote(uri))
        if path.is_absolute() or ".." in path.parts or ":" in uri or "\\" in uri:
            raise ValueError(f"a buffer outside of the file's folder: {uri[:80]}")
        self.beside.append(self._folder / path)
        with open(self.beside[-1], "rb") as stream:
            return memoryview(mmap(stream.fileno(), 0, access=ACCESS_READ))


def _nodes(document: _Document) -> list[_Node]:
    entries = document.lists.get("nodes", [])
    parents = [-1] * len(entries)
    for place, entry in enumerate(entries):
        for child in entry.get("children", ()):
            list_entry(document.lists, "nodes", child)
            if parents[child] >= 0 or child == place:
                raise ValueError("a node with two parents")
            parents[child] = place
    return [_node(entry, place, parents[place]) for place, entry in enumerate(entries)]


def _node(entry: dict[str, Any], place: int, parent: int) -> _Node:
    name = entry.get("name", f"node {place}")
    matrix = entry.get("matrix")
    return _Node(
        str(name),
        parent,
        _vector(entry.get("translation", (0, 0, 0)), 3),
        _vector(entry.get("rotation", (0, 0, 0, 1)), 4),
        _vector(entry.get("scale", (1, 1, 1)), 3),
        # columns one after the other
        None if matrix is None else _vector(matrix, 16).reshape(4, 4).T,
    )


def _vector(values: Any, size: int) -> np.ndarray:
    vector = np.array(values, dtype=np.float64)
    if vector.shape != (size,) or not np.isfinite(vector).all():
        raise ValueError(f"{size} numbers of a node wanted, found {str(values)[:60]}")
    return vector


def _with_ancestors(nodes: list[_Node], wanted: set[int]) -> list[int]:
    """The nodes and all above them, parents first. ValueError for a ring of nodes."""
    order: list[int] = []
    placed: set[int] = set()
    for node in sorted(wanted):
        path: list[int] = []
        while node >= 0 and node not in placed:
            path.append(node)
            if len(path) > len(nodes):
                raise ValueError("nodes that are their own ancestors")
            node = nodes[node].parent
        order += reversed(path)
        placed.update(path)
    return order


def _channels(
    document: _Document, kept: set[int], part: str | None
) -> tuple[list[_Channel], tuple[str, ...], list[str]]:
    """The channels of one animation that move the kept nodes, the names of all that do, and what is to be said about
    the choice."""
    animations = document.lists.get("animations", [])
    moving = []
    for number, animation in enumerate(animations):
        name = str(animation.get("name", f"animation {number}"))
        touched = [entry for entry in objects(animation, "channels") if _target(entry) in kept]
        if touched:
            moving.append((name, animation, touched))
    names = tuple(name for name, _, _ in moving)
    if part is not None and (chosen := named(part, names)):
        moving = [moving[place] for place in chosen]
    if not moving:
        return [], names, ["No animation moves its hands: its pose is one frame."] if kept else []
    name, animation, touched = max(moving, key=lambda one: len(one[2]))
    notes = []
    if len(moving) > 1:
        others = ", ".join(other for other, _, _ in moving if other != name)[:200]
        notes.append(f"Of its {len(moving)} animations '{name}' was taken; --part chooses another: {others}.")
    samplers = objects(animation, "samplers")
    channels = [_channel(document, samplers, entry) for entry in touched]
    return [channel for channel in channels if channel is not None], names, notes


def _target(entry: dict[str, Any]) -> Any:
    target = entry.get("target")
    node = target.get("node") if isinstance(target, dict) else None
    return node if isinstance(node, int) else None


def _channel(document: _Document, samplers: list[dict[str, Any]], entry: dict[str, Any]) -> _Channel | None:
    path = str(entry["target"].get("path"))
    if path not in _PATHS:
        return None
    index = entry.get("sampler")
    if not isinstance(index, int) or not 0 <= index < len(samplers):
        raise ValueError("a channel without a sampler")
    sampler = samplers[index]
    interpolation = str(sampler.get("interpolation", "LINEAR"))
    if interpolation not in ("LINEAR", "STEP", "CUBICSPLINE"):
        raise ValueError(f"interpolation {interpolation[:40]}")
    times_s = document.values(sampler.get("input"), 1)[:, 0]
    values = document.values(sampler.get("output"), _PATHS[path])
    rows = len(times_s) * (3 if interpolation == "CUBICSPLINE" else 1)
    if len(values) != rows or (np.diff(times_s) <= 0).any() or not math.isfinite(times_s[-1]):
        raise ValueError("keys whose times do not rise, or without a value each")
    return _Channel(entry["target"]["node"], path, interpolation, times_s, values)
