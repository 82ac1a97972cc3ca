"""Attributes of the Gaussians in a binary glTF file whose content is not trusted."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from mmap import mmap
from typing import Any

import numpy as np

from jghand_engine.exporters.gltf_splats import BINARY_CHUNK, EXTENSION, JSON_CHUNK, MAGIC, VERSION
from jghand_engine.limits import GLB_JSON_BYTES_MAX

_TYPES = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
# component type -> of numbers, and what whole ones stand for 1
_COMPONENTS = {5126: ("<f4", 1), 5121: ("u1", 255), 5123: ("<u2", 65535), 5120: ("i1", 127), 5122: ("<i2", 32767)}


def glb_attributes(content: mmap, widths: Mapping[str, int]) -> list[np.ndarray]:
    """float32 arrays (N, width), copied, of the only primitive of Gaussians: name of the attribute -> width.

    ValueError says what is wrong.
    """
    about, binary_start, binary_size = _chunks(content)
    primitives = [
        primitive
        for mesh in _list(about, "meshes")
        for primitive in _list(_object(mesh), "primitives")
        if EXTENSION in _object(_object(primitive).get("extensions", {}))
    ]
    if len(primitives) != 1:
        raise ValueError(f"{len(primitives)} primitives with {EXTENSION}")
    attributes = _object(primitives[0].get("attributes", {}))
    missing = [name for name in widths if name not in attributes]
    if missing:
        raise ValueError(f"no attribute {', '.join(missing)}")
    found = []
    for name, width in widths.items():
        accessor = _entry(about, "accessors", attributes[name])
        found.append(_values(content, about, accessor, width, (binary_start, binary_size)))
    if len({len(array) for array in found}) != 1:
        raise ValueError("attributes of different lengths")
    return found


def _chunks(content: mmap) -> tuple[dict[str, Any], int, int]:
    """The description, and where the binary chunk begins and how long it is."""
    size = len(content)
    if size < 20:
        raise ValueError(f"{size} bytes")
    magic, version, total, text_bytes, kind = struct.unpack_from("<IIIII", content)
    if (magic, version, kind) != (MAGIC, VERSION, JSON_CHUNK):
        raise ValueError("another beginning")
    if total != size:
        raise ValueError(f"{size} bytes where its header says {total}")
    if text_bytes > min(GLB_JSON_BYTES_MAX, size - 20):
        raise ValueError(f"a description of {text_bytes} bytes, wanted at most {GLB_JSON_BYTES_MAX}")
    try:
        about = json.loads(content[20 : 20 + text_bytes])
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a description that is no JSON: {error}") from error
    start = 20 + text_bytes
    if size < start + 8:
        raise ValueError("no binary chunk")
    binary_bytes, kind = struct.unpack_from("<II", content, start)
    if kind != BINARY_CHUNK or binary_bytes > size - start - 8:
        raise ValueError(f"a binary chunk of {binary_bytes} bytes in a file of {size}")
    return _object(about), start + 8, binary_bytes


def _values(
    content: mmap, about: dict[str, Any], accessor: dict[str, Any], width: int, binary: tuple[int, int]
) -> np.ndarray:
    if "sparse" in accessor or [name for name, one in _TYPES.items() if one == width] != [accessor.get("type")]:
        raise ValueError(f"a sparse accessor, or one of type {accessor.get('type')!r}")
    component = accessor.get("componentType")
    if not isinstance(component, int) or component not in _COMPONENTS:
        raise ValueError(f"component type {component!r}")
    dtype, one = _COMPONENTS[component]
    view = _entry(about, "bufferViews", accessor.get("bufferView"))
    if _number(view, "buffer") != 0 or "uri" in _entry(about, "buffers", 0):
        raise ValueError("numbers in another file")
    each = np.dtype(dtype).itemsize
    row = each * width
    count, stride = _number(accessor, "count"), _number(view, "byteStride", row)
    start, size = _number(view, "byteOffset", 0), _number(view, "byteLength")
    inner = _number(accessor, "byteOffset", 0)
    if stride < row or start + size > binary[1] or inner + (count - 1) * stride + row > size or not count:
        raise ValueError(f"an accessor of {count} rows beyond its bytes")
    if (start + inner) % each or stride % each:
        raise ValueError("numbers that do not begin where numbers of their size may")
    array = np.ndarray((count, width), dtype, content, binary[0] + start + inner, (stride, each))
    return array.astype(np.float32) / np.float32(one) if one > 1 else array.astype(np.float32)


def _object(value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"{type(value).__name__} where an object was wanted")
    return value


def _list(value: dict[str, Any], name: str) -> list[Any]:
    entries = value.get(name, [])
    if not isinstance(entries, list):
        raise ValueError(f"{name} is no list")
    return entries


def _entry(about: dict[str, Any], name: str, index: Any) -> dict[str, Any]:
    entries = _list(about, name)
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(entries):
        raise ValueError(f"no {name} of number {index!r}"[:200])
    return _object(entries[index])


def _number(value: dict[str, Any], name: str, default: int | None = None) -> int:
    """A count or an offset."""
    number = value.get(name, default)
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 2**40:
        raise ValueError(f"{name} {number!r}"[:200])
    return number
