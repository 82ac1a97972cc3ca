"""Attributes of the Gaussians in a binary glTF file whose content is not trusted."""

from __future__ import annotations

import json
from collections.abc import Mapping
from mmap import mmap
from typing import Any

import numpy as np

from jghand_engine.datasets.gltf_content import accessor_rows, as_object, glb_chunks, list_entry, objects
from jghand_engine.exporters.gltf_splats import EXTENSION
from jghand_engine.limits import GLB_JSON_BYTES_MAX


def glb_attributes(content: mmap, widths: Mapping[str, int]) -> list[np.ndarray]:
    """float32 arrays (N, width), copied, of the only primitive of Gaussians: name of the attribute -> width.

    ValueError says what is wrong.
    """
    with memoryview(content) as whole:
        text, binary = glb_chunks(whole, GLB_JSON_BYTES_MAX)
        try:
            return _attributes(_described(text), binary, widths)
        finally:
            # a mapped file cannot be closed while anything looks at it
            text.release()
            if binary is not None:
                binary.release()


def _attributes(about: dict[str, Any], binary: memoryview | None, widths: Mapping[str, int]) -> list[np.ndarray]:
    primitives = [
        primitive
        for mesh in objects(about, "meshes")
        for primitive in objects(mesh, "primitives")
        if EXTENSION in as_object(primitive.get("extensions", {}))
    ]
    if len(primitives) != 1:
        raise ValueError(f"{len(primitives)} primitives with {EXTENSION}")
    attributes = as_object(primitives[0].get("attributes", {}))
    missing = [name for name in widths if name not in attributes]
    if missing:
        raise ValueError(f"no attribute {', '.join(missing)}")

    def buffer(index: Any) -> memoryview:
        if index != 0 or "uri" in list_entry(about, "buffers", 0) or binary is None:
            raise ValueError("numbers in another file")
        return binary

    found = [_values(*accessor_rows(about, attributes[name], width, buffer)) for name, width in widths.items()]
    if len({len(array) for array in found}) != 1:
        raise ValueError("attributes of different lengths")
    return found


def _described(text: memoryview) -> dict[str, Any]:
    try:
        return as_object(json.loads(bytes(text)))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a description that is no JSON: {error}") from error


def _values(rows: np.ndarray, one: int) -> np.ndarray:
    return rows.astype(np.float32) / np.float32(one) if one > 1 else rows.astype(np.float32)
