"""UV layouts for surfaces that bring none: from an .obj file, or by projection; and room for the wrist cap."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.ndimage import distance_transform_edt

from jghand_engine.errors import InputError
from jghand_engine.template.surface import face_normals
from jghand_engine.template.texture import rasterize_uv

# empty border of a layout made by us and the gap between its parts; texels in which room for the cap is looked for
UV_MARGIN = 0.02
UV_ROOM_PX = 256
OBJ_BYTES_MAX = 64 * 2**20
# radius of the disk that the wrist cap gets in a UV square, at most; and its part of the free circle there
CAP_UV_RADIUS_MAX = 0.06
CAP_UV_FILL = 0.8


def projected_uv(vertices_m: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 2) corner UVs of a flat hand in the canonical frame: the palm on the left, the back on the right.

    Every face is projected along z into the half that it faces, the back mirrored so that nothing is turned over.
    Simple and without a file, but the sides of the fingers are squeezed and the two halves meet in a seam.
    """
    low, high = vertices_m[:, :2].min(axis=0), vertices_m[:, :2].max(axis=0)
    width, height = high - low
    scale = min((1 - 3 * UV_MARGIN) / (2 * width), (1 - 2 * UV_MARGIN) / height)
    corners = vertices_m[faces][..., :2]
    back = face_normals(vertices_m, faces)[:, 2] < 0
    x = np.where(back[:, None], high[0] - corners[..., 0], corners[..., 0] - low[0]) * scale
    x += np.where(back[:, None], 2 * UV_MARGIN + width * scale, UV_MARGIN)
    return np.stack([x, UV_MARGIN + (corners[..., 1] - low[1]) * scale], axis=-1)


def obj_uv(path: Path | str, faces: np.ndarray) -> np.ndarray:
    """(F, 3, 2) corner UVs of `faces`, read from a Wavefront .obj file with the same vertex numbers.

    Faces are found by their vertices, so their order and direction in the file do not matter. InputError names the
    line that is wrong, or a face that is not there.
    """
    uv, corner_uv = _read_obj(Path(path))
    if len(uv) == 0 or not np.isfinite(uv).all() or uv.min() < 0 or uv.max() > 1:
        raise InputError(f"UV file {path}", wanted="texture coordinates 0..1", came="others or none")
    index = np.zeros(faces.shape, dtype=np.int64)
    for number, face in enumerate(faces):
        corners = [int(vertex) for vertex in face]
        found = corner_uv.get(frozenset(corners))
        if found is None:
            raise InputError(f"UV file {path}", wanted=f"a face with the vertices {corners}", came="none")
        index[number] = [found[vertex] for vertex in corners]
    return uv[index]


def _read_obj(path: Path) -> tuple[np.ndarray, dict[frozenset[int], dict[int, int]]]:
    """Texture coordinates (n, 2), and for each face its texture number by vertex number (both from 0)."""
    try:
        if path.stat().st_size > OBJ_BYTES_MAX:
            raise InputError(f"UV file {path}", wanted=f"at most {OBJ_BYTES_MAX} bytes", came="more")
        lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"UV file {path}", wanted="a file that can be read", came=str(error)) from error
    uv: list[list[float]] = []
    faces: dict[frozenset[int], dict[int, int]] = {}
    for number, line in enumerate(lines, start=1):
        words = line.split()
        try:
            if words[:1] == ["vt"]:
                uv.append([float(words[1]), float(words[2])])
            elif words[:1] == ["f"]:
                corners = dict(_corner(word) for word in words[1:])
                if len(words) != 4 or len(corners) != 3 or max(corners.values()) >= len(uv):
                    raise ValueError("wanted a triangle with texture coordinates")
                faces[frozenset(corners)] = corners
        except (ValueError, IndexError) as error:
            raise InputError(
                f"UV file {path}, line {number}", wanted="a Wavefront .obj file", came=str(error)
            ) from error
    return np.array(uv, dtype=float).reshape(-1, 2), faces


def _corner(word: str) -> tuple[int, int]:
    """'vertex/texture' or 'vertex/texture/normal', counted from 1, to numbers from 0."""
    vertex, texture = (int(part) - 1 for part in word.split("/")[:2])
    if vertex < 0 or texture < 0:
        raise ValueError("wanted numbers that count from 1")
    return vertex, texture


def room_for_disk(face_uv: np.ndarray) -> tuple[tuple[float, float], float]:
    """Center and radius of a disk that touches no face of the layout (F, 3, 2): a place for the wrist cap."""
    _, covered = rasterize_uv(face_uv, np.zeros((*face_uv.shape[:2], 1)), UV_ROOM_PX)
    free = np.pad(~covered, 1)
    distance = np.asarray(distance_transform_edt(free))[1:-1, 1:-1]
    row, column = np.unravel_index(distance.argmax(), distance.shape)
    # a texel may be covered in part without its center being so
    radius = min(CAP_UV_FILL * (distance[row, column] - 1) / UV_ROOM_PX, CAP_UV_RADIUS_MAX)
    if radius <= 0:
        raise InputError("UV layout", wanted="free room for the wrist cap", came="a full square")
    return ((column + 0.5) / UV_ROOM_PX, 1 - (row + 0.5) / UV_ROOM_PX), float(radius)
