"""A smooth surface from a coarse one: Loop's subdivision of a closed triangle mesh, as one sparse matrix.

The matrix depends on the faces alone, so that one serves all poses and all hands of the template. Source: Loop, Smooth
Subdivision Surfaces Based on Triangles, 1987, with his weights at every valence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from jghand_engine.render.fine_faces import parted_in_four
from jghand_engine.template.surface import directed_edges

# new vertices on edges: shares of the edge's two ends, and of the two corners across it
EDGE_END, EDGE_ACROSS = 3 / 8, 1 / 8


@dataclass(frozen=True)
class Subdivision:
    """A finer mesh and how its vertices follow from those of the coarse one.

    levels:  how often each face became four
    faces:   (F, 3); those of coarse face k are number k * 4**levels and those that follow it
    face_uv: (F, 3, 2), linear within each coarse face: seams stay where they are
    matrix:  (V, coarse V) sparse, rows sum to 1
    """

    levels: int
    faces: np.ndarray
    face_uv: np.ndarray
    matrix: sparse.csr_array

    @classmethod
    def of(cls, faces: np.ndarray, face_uv: np.ndarray, levels: int) -> Subdivision:
        """faces (F, 3) of a closed surface, face_uv (F, 3, 2)."""
        count = int(faces.max()) + 1
        matrix = sparse.csr_array(sparse.eye_array(count))
        for _ in range(levels):
            faces, face_uv, step = _once(faces, face_uv, int(faces.max()) + 1)
            matrix = sparse.csr_array(step @ matrix)
        return cls(levels, faces, face_uv, matrix)

    @property
    def corner(self) -> np.ndarray:
        """(V,) one face corner, numbered through, at each vertex: to look textures up with its UV."""
        corner = np.zeros(int(self.faces.max()) + 1, dtype=np.int64)
        corner[self.faces.reshape(-1)] = np.arange(self.faces.size)
        return corner

    def places(self, face: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points of coarse faces, by their number (N,) and the shares (N, 3) of its corners in the texture -> the same
        of the fine faces: where the texture has them on the smooth surface."""
        for _ in range(self.levels):
            part = np.where(shares.max(1) > 0.5, shares.argmax(1), 3)
            outside = 2 * np.take_along_axis(shares, (part[:, None] + np.arange(3)) % 3, 1)
            outside[:, 0] -= 1
            # the inner face's corners are the middles of the edges, each opposite the coarse corner two places on
            inside = 1 - 2 * shares[:, [2, 0, 1]]
            shares = np.where(part[:, None] == 3, inside, outside)
            face = 4 * face + part
        return face, shares


def _once(faces: np.ndarray, face_uv: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, sparse.csr_array]:
    edges, number = np.unique(np.sort(directed_edges(faces), axis=1), axis=0, return_inverse=True)
    # (F, 3): the edges from corner k to corner k + 1, and the corners across from them
    number = number.reshape(3, -1).T
    across = faces[:, [2, 0, 1]]
    rows = np.concatenate([np.repeat(np.arange(len(edges)), 2), number.reshape(-1)])
    columns = np.concatenate([edges.reshape(-1), across.reshape(-1)])
    shares = np.repeat([EDGE_END, EDGE_ACROSS], [edges.size, faces.size])
    odd = sparse.coo_array((shares, (rows, columns)), (len(edges), count))
    ends = np.concatenate([edges, edges[:, ::-1]])
    neighbors = sparse.csr_array(sparse.coo_array((np.ones(len(ends)), tuple(ends.T)), (count, count)))
    valence = np.asarray(neighbors.sum(1)).ravel()
    beta = (5 / 8 - (3 / 8 + np.cos(2 * np.pi / valence) / 4) ** 2) / valence
    even = sparse.diags_array(1 - valence * beta) + sparse.diags_array(beta) @ neighbors
    finer = parted_in_four(faces, number + count)
    finer_uv = parted_in_four(face_uv, (face_uv + np.roll(face_uv, -1, axis=1)) / 2)
    return finer, finer_uv, sparse.csr_array(sparse.vstack([even, odd]))
