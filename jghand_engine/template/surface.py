"""Triangle surfaces: boundary loops, closing them, normals. Plain arrays, no hand knowledge."""

from __future__ import annotations

import numpy as np

from jghand_engine.errors import InputError
from jghand_engine.hand.rotations import unit


def directed_edges(faces: np.ndarray) -> np.ndarray:
    """(3F, 2) directed edges of `faces` (F, 3): the three first edges of all faces follow one another by corner."""
    return np.concatenate([faces[:, [k, (k + 1) % 3]] for k in range(3)])


def boundary_loop(faces: np.ndarray) -> np.ndarray:
    """The vertices (m,) around the only opening of a surface, in the direction of the faces' edges.

    It starts at the smallest vertex number, so that a rebuild is equal. Raises InputError when the surface is closed,
    has several openings or is not a manifold there.
    """
    edges = {(int(a), int(b)) for a, b in directed_edges(faces)}
    following = [(a, b) for a, b in edges if (b, a) not in edges]
    after = dict(following)
    if not after or len(after) != len(following):
        raise InputError("the surface's opening", wanted="one loop", came=f"{len(following)} open edges")
    loop = [min(after)]
    while (vertex := after.get(loop[-1])) != loop[0]:
        if vertex is None or len(loop) > len(after):
            raise InputError("the surface's opening", wanted="one loop", came="an open chain")
        loop.append(vertex)
    if len(loop) != len(after):
        raise InputError("the surface's opening", wanted="one loop", came="several")
    return np.array(loop)


def fan_faces(loop: np.ndarray, center: int) -> np.ndarray:
    """(m, 3) faces that close the opening `loop` (m,) with the vertex `center`, oriented like the surface."""
    return np.stack([np.roll(loop, -1), loop, np.full_like(loop, center)], axis=1)


def disk_uv(count: int, center: tuple[float, float], radius: float) -> np.ndarray:
    """(count, 3, 2) corner UVs of a fan of `count` faces (see `fan_faces`) laid out as a disk."""
    angle = np.arange(count) * (2 * np.pi / count)
    ring = np.array(center) + radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.stack([np.roll(ring, -1, axis=0), ring, np.broadcast_to(np.array(center), ring.shape)], axis=1)


def one_uv_each(faces: np.ndarray, face_uv: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A surface whose vertices have one UV each, as files and graphics cards want it: numbers (V,) of the vertices of
    `faces` (F, 3) that they are, their UVs (V, 2) of those of the corners (F, 3, 2), and faces (F, 3) of these."""
    corners = np.column_stack([faces.reshape(-1), face_uv.reshape(-1, 2)])
    rows, number = np.unique(corners, axis=0, return_inverse=True)
    return rows[:, 0].astype(int), rows[:, 1:], number.reshape(-1, 3)


def face_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(F, 3) unit outward normals; 0 for a face without area."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return unit(np.cross(b - a, c - a))


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) unit normals, the faces weighted by their angle at the vertex.

    Angle weights are what makes the sign of a distance right at a vertex (Baerentzen and Aanaes 2005).
    """
    normals = face_normals(vertices, faces)
    total = np.zeros_like(vertices)
    for k in range(3):
        corner, left, right = (vertices[faces[:, (k + step) % 3]] for step in (0, 1, 2))
        cosine = np.sum(unit(left - corner) * unit(right - corner), axis=1)
        np.add.at(total, faces[:, k], normals * np.arccos(np.clip(cosine, -1, 1))[:, None])
    return unit(total)


def edge_normals(faces: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(F, 3, 3) unit normals of the edges opposite no corner: entry k is the edge from corner k to corner k + 1.

    Mean of the two faces at the edge; of a border edge its only face.
    """
    edges = np.sort(directed_edges(faces), axis=1)
    _, number = np.unique(edges, axis=0, return_inverse=True)
    number = number.reshape(3, -1)
    total = np.zeros((number.max() + 1, 3))
    for k in range(3):
        np.add.at(total, number[k], normals)
    return unit(total)[number].transpose(1, 0, 2)


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume inside a closed surface; positive when the faces point outwards."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6)


def is_closed(faces: np.ndarray) -> bool:
    """Every directed edge occurs once, and its reverse too: a closed surface of consistent orientation."""
    edges = directed_edges(faces)
    forward = np.unique(edges, axis=0)
    return len(forward) == len(edges) and np.array_equal(forward, np.unique(edges[:, ::-1], axis=0))
