"""Gaussians of binary glTF files of anybody, with the extension KHR_gaussian_splatting."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np

from jghand_engine.export.splats.cloud import SplatCloud
from jghand_engine.export.splats.gltf import EXTENSION
from jghand_engine.export.splats.rows import SplatRows, damaged
from jghand_engine.limits import GLB_JSON_BYTES_MAX, SH_C0
from jghand_engine.motion.gltf_content import accessor_rows, as_object, glb_chunks, list_entry, objects

# attributes -> how many numbers
_WIDTHS = {
    "POSITION": 3, f"{EXTENSION}:ROTATION": 4, f"{EXTENSION}:SCALE": 3, f"{EXTENSION}:OPACITY": 1,
    f"{EXTENSION}:SH_DEGREE_0_COEF_0": 3,
}  # fmt: skip
# maps of a node -> those that change nothing, which many programs write
_MAPS = {
    "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1],
    "translation": [0, 0, 0], "rotation": [0, 0, 0, 1], "scale": [1, 1, 1],
}  # fmt: skip


def glb_rows(path: Path, stream: IO[bytes]) -> SplatRows:
    """The Gaussians of an open file, where its mesh has them. InputError, which names it, for one that is damaged or
    lies."""
    try:
        text, binary = glb_chunks(np.memmap(stream, np.uint8, "r").data, GLB_JSON_BYTES_MAX)
        about = _described(text)
        mesh, attributes = _gaussians(about)
        arrays = [_numbers(about, attributes[name], width, binary) for name, width in _WIDTHS.items()]
        placed = _is_placed(about, mesh)
    except ValueError as error:
        raise damaged(path, "one primitive of Gaussians in a binary glTF file", error) from error
    if len({len(array) for array, _ in arrays}) != 1:
        raise damaged(path, "one primitive of Gaussians in a binary glTF file", "attributes of different lengths")

    def part(rows: slice) -> SplatCloud:
        position, turn, scale, opacity, harmonics = (_floats(array[rows], one) for array, one in arrays)
        rgb = harmonics * np.float32(SH_C0) + np.float32(0.5)
        return SplatCloud(position, scale, turn[:, [3, 0, 1, 2]], opacity[:, 0], rgb, "rub")

    said = "a node of the file moves, turns or scales the Gaussians: sizes here are before that"
    return SplatRows(path, len(arrays[0][0]), "rub", part, (said,) if placed else ())


def _gaussians(about: dict[str, Any]) -> tuple[int, dict[str, Any]]:
    """The number of the mesh with the only primitive of Gaussians, and the primitive's attributes."""
    found = [
        (number, as_object(primitive.get("attributes", {})))
        for number, mesh in enumerate(objects(about, "meshes"))
        for primitive in objects(mesh, "primitives")
        if EXTENSION in as_object(primitive.get("extensions", {}))
    ]
    if len(found) != 1:
        raise ValueError(f"{len(found)} primitives with {EXTENSION}")
    missing = [name for name in _WIDTHS if name not in found[0][1]]
    if missing:
        raise ValueError(f"no attribute {', '.join(missing)}")
    return found[0]


def _numbers(about: dict[str, Any], index: Any, width: int, binary: memoryview | None) -> tuple[np.ndarray, int]:
    """Rows of an attribute as they are in the file, and what stands for 1 in them: 1 but for normalized ones."""

    def buffer(number: Any) -> memoryview:
        if number != 0 or "uri" in list_entry(about, "buffers", 0) or binary is None:
            raise ValueError("numbers in another file")
        return binary

    rows, one = accessor_rows(about, index, width, buffer)
    return rows, one if list_entry(about, "accessors", index).get("normalized") is True else 1


def _floats(rows: np.ndarray, one: int) -> np.ndarray:
    values = rows.astype(np.float32)
    return np.maximum(values / np.float32(one), np.float32(-1)) if one > 1 else values


def _is_placed(about: dict[str, Any], mesh: int) -> bool:
    """Whether a node with the mesh, or one above such a node, has a map that changes something."""
    nodes = objects(about, "nodes")
    parents = {child: number for number, node in enumerate(nodes) for child in _children(node)}
    above: list[int] = [number for number, node in enumerate(nodes) if node.get("mesh") == mesh]
    seen: set[int] = set()
    while above:
        number = above.pop()
        if number not in seen and number in parents:
            above.append(parents[number])
        seen.add(number)
    return any(nodes[number].get(name, none) != none for number in seen for name, none in _MAPS.items())


def _children(node: dict[str, Any]) -> Iterator[int]:
    children = node.get("children", [])
    if not isinstance(children, list):
        raise ValueError("children that are no list")
    return (child for child in children if isinstance(child, int))


def _described(text: memoryview) -> dict[str, Any]:
    try:
        return as_object(json.loads(bytes(text)))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a description that is no JSON: {error}") from error
