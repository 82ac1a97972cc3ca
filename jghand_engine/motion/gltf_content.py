"""What is in a glTF 2.0 file whose content is not trusted: its chunks, the entries of its lists, rows of its numbers.

Nothing is believed before it is compared with the bytes that are there. Everything raises ValueError, which says what
is wrong.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

MAGIC = b"glTF"
VERSION, JSON_CHUNK, BINARY_CHUNK = 2, 0x4E4F534A, 0x004E4942
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
# component type -> of numbers, and what whole ones stand for 1
_COMPONENTS = {5126: ("<f4", 1), 5121: ("u1", 255), 5123: ("<u2", 65535), 5120: ("i1", 127), 5122: ("<i2", 32767)}


def glb_chunks(content: memoryview, most_json_bytes: int) -> tuple[memoryview, memoryview | None]:
    """The description of a .glb, JSON of at most so many bytes, and its binary chunk, None where it has none."""
    size = len(content)
    if size < 20:
        raise ValueError(f"{size} bytes")
    magic, version, total, text_bytes, kind = struct.unpack_from("<4sIIII", content)
    if (magic, version, kind) != (MAGIC, VERSION, JSON_CHUNK):
        raise ValueError("another beginning than that of glTF 2.0")
    if total != size:
        raise ValueError(f"{size} bytes where its header says {total}")
    if text_bytes > min(most_json_bytes, size - 20):
        raise ValueError(f"a description of {text_bytes} bytes, wanted at most {most_json_bytes}")
    start = 20 + text_bytes
    if size < start + 8:
        return content[20:start], None
    binary_bytes, kind = struct.unpack_from("<II", content, start)
    if kind != BINARY_CHUNK or binary_bytes > size - start - 8:
        raise ValueError(f"a binary chunk of {binary_bytes} bytes in a file of {size}")
    return content[20:start], content[start + 8 : start + 8 + binary_bytes]


def accessor_rows(
    about: Mapping[str, Any], index: Any, width: int, buffer: Callable[[Any], memoryview]
) -> tuple[np.ndarray, int]:
    """Rows (N, width) of an accessor, as they are in the file, not copied, and what stands for 1 in whole numbers.

    buffer: the bytes of the buffer of a number.
    """
    accessor = list_entry(about, "accessors", index)
    if "sparse" in accessor or _WIDTHS.get(str(accessor.get("type"))) != width:
        raise ValueError(f"a sparse accessor, or one of type {str(accessor.get('type'))[:40]!r}")
    component = accessor.get("componentType")
    if not isinstance(component, int) or component not in _COMPONENTS:
        raise ValueError(f"component type {str(component)[:40]}")
    dtype, one = _COMPONENTS[component]
    view = list_entry(about, "bufferViews", accessor.get("bufferView"))
    binary = buffer(view.get("buffer"))
    each = np.dtype(dtype).itemsize
    row = each * width
    count, stride = whole(accessor, "count"), whole(view, "byteStride", row)
    start, size = whole(view, "byteOffset", 0), whole(view, "byteLength")
    inner = whole(accessor, "byteOffset", 0)
    if not count or stride < row or start + size > len(binary) or inner + (count - 1) * stride + row > size:
        raise ValueError(f"an accessor of {count} rows beyond its bytes")
    if (start + inner) % each or stride % each:
        raise ValueError("numbers that do not begin where numbers of their size may")
    return np.ndarray((count, width), dtype, binary, start + inner, (stride, each)), one


def list_entry(about: Mapping[str, Any], name: str, index: Any) -> dict[str, Any]:
    """The entry of a number in a list of the file."""
    entries = about.get(name, [])
    if not isinstance(entries, list):
        raise ValueError(f"{name} that are no list")
    if not isinstance(index, int) or isinstance(index, bool) or not 0 <= index < len(entries):
        raise ValueError(f"no {name} of number {str(index)[:40]}")
    return as_object(entries[index])


def objects(about: Mapping[str, Any], name: str) -> list[dict[str, Any]]:
    """A list of objects, [] where there is none."""
    entries = about.get(name, [])
    if not isinstance(entries, list):
        raise ValueError(f"{name} that are no list")
    return [as_object(one) for one in entries]


def as_object(value: Any) -> dict[str, Any]:
    """A JSON object."""
    if not isinstance(value, dict):
        raise ValueError(f"{type(value).__name__} where an object was wanted")
    return value


def whole(about: Mapping[str, Any], name: str, default: int | None = None) -> int:
    """A count or an offset."""
    number = about.get(name, default)
    if not isinstance(number, int) or isinstance(number, bool) or not 0 <= number < 2**40:
        raise ValueError(f"{name} {str(number)[:40]}")
    return number
