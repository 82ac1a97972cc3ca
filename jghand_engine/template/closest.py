"""The closest point of a closed triangle surface, exactly and for many points at once, and on which side they are.

A k-d tree over the centers of small pieces of the faces proposes candidates; a point is finished when the farthest
proposed piece cannot hold anything nearer, else it asks for more. So the result is exact, whatever the mesh.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.spatial import KDTree

from jghand_engine.template.surface import edge_normals, face_normals, vertex_normals

# closest points: faces are searched in pieces of at most this radius (meters), so many at first, and so many in all.
# Speed only: the search asks for more pieces until it is certain (32 are enough for 9 in 10 points near the skin)
CLOSEST_PIECE_RADIUS_M = 0.002
CLOSEST_FIRST_CANDIDATES = 32
# pieces are passed over when they are farther than the nearest found by more than this part of it: rounding of float64,
# amply, so that of two equally near faces the same is chosen however many were asked for
CLOSEST_ROUNDING = 1e-9
# a triangle whose corner has a squared sine below this is taken for its edges, from which it then differs by a
# millionth of its length at most: rounding leaves 4e-16 where the area is none
CLOSEST_FLAT = 1e-12
CLOSEST_PIECES_MAX = 2_000_000
# (points x candidates) worked on at once: bounds the memory to about 100 MB
CLOSEST_BATCH = 300_000


@dataclass(frozen=True)
class ClosestPoints:
    """For N points: the closest point of the surface.

    point_m:     (N, 3) meters
    face:        (N,) face number
    barycentric: (N, 3) weights of the face's corners
    signed_m:    (N,) distance, negative inside
    """

    point_m: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    signed_m: np.ndarray

    def rows(self, chosen: np.ndarray) -> ClosestPoints:
        """Those of the points `chosen` (indices)."""
        return ClosestPoints(self.point_m[chosen], self.face[chosen], self.barycentric[chosen], self.signed_m[chosen])

    @classmethod
    def joined(cls, parts: Sequence[ClosestPoints]) -> ClosestPoints:
        """Those of several sets of points, one after the other."""
        names = [field.name for field in fields(cls)]
        return cls(**{name: np.concatenate([getattr(part, name) for part in parts]) for name in names})


class Surface:
    """A closed surface (vertices (V, 3) meters, faces (F, 3), counter-clockwise from outside) that can be asked."""

    def __init__(self, vertices_m: np.ndarray, faces: np.ndarray) -> None:
        self.corners_m = vertices_m[faces]
        self._normals = face_normals(vertices_m, faces)
        self._edge_normals = edge_normals(faces, self._normals)
        self._corner_normals = vertex_normals(vertices_m, faces)[faces]
        centers, self._piece_face, self._piece_radii_m = _pieces(self.corners_m)
        self.piece_radius_m = float(self._piece_radii_m.max())
        self._tree = KDTree(centers)

    def normals(self, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """(N, 3) unit outward normals, interpolated between the vertices' normals."""
        mixed = np.einsum("nk,nkc->nc", barycentric, self._corner_normals[face])
        length = np.linalg.norm(mixed, axis=1, keepdims=True)
        return np.where(length > 0, mixed / np.where(length > 0, length, 1), self._normals[face])

    def closest(self, points_m: np.ndarray) -> ClosestPoints:
        """The closest surface point of every point (N, 3)."""
        count = len(points_m)
        face, bary = np.zeros(count, dtype=np.int64), np.zeros((count, 3))
        squared = np.full(count, np.inf)
        open_points, candidates = np.arange(count), CLOSEST_FIRST_CANDIDATES
        while len(open_points):
            candidates = min(candidates, self._tree.n)
            unfinished = []
            batches = min(len(open_points), 1 + len(open_points) * candidates // CLOSEST_BATCH)
            for batch in np.array_split(open_points, batches):
                result = self._best_of(points_m[batch], candidates)
                face[batch], bary[batch], squared[batch], finished = result
                unfinished.append(batch[~finished])
            open_points, candidates = np.concatenate(unfinished), candidates * 4
        point = np.einsum("nk,nkc->nc", bary, self.corners_m[face])
        outside = np.sum((points_m - point) * self._pseudonormals(face, bary), axis=1) >= 0
        return ClosestPoints(point, face, bary, np.where(outside, 1, -1) * np.sqrt(squared))

    def rough(self, points_m: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Fast: a face (N,) near each point, and a distance (N,) that is at most `piece_radius_m` too large."""
        distance, piece = self._tree.query(points_m)
        return self._piece_face[piece], distance

    def _best_of(self, points_m: np.ndarray, candidates: int) -> tuple[np.ndarray, ...]:
        """Face, barycentrics, squared distance of the best among the nearest pieces, and whether none can be better."""
        reach, piece = self._tree.query(points_m, k=candidates)
        reach, piece = reach.reshape(len(points_m), -1), piece.reshape(len(points_m), -1)
        # the nearest center is a point of the surface: what is farther than it with all of its piece cannot be nearest
        possible = reach - self._piece_radii_m[piece] <= reach[:, :1] * (1 + CLOSEST_ROUNDING)
        row, face = _each_once(self._piece_face[piece], possible)
        bary, squared = closest_on_triangle(points_m[row], self.corners_m[face])
        starts = np.searchsorted(row, np.arange(len(points_m)))
        least = np.minimum.reduceat(squared, starts)
        ties = np.flatnonzero(squared == least[row])
        best = ties[np.searchsorted(row[ties], np.arange(len(points_m)))]
        finished = (reach[:, -1] - self.piece_radius_m >= np.sqrt(least)) | (candidates == self._tree.n)
        return face[best], bary[best], least, finished

    def _pseudonormals(self, face: np.ndarray, bary: np.ndarray) -> np.ndarray:
        """Normals of the feature (face, edge or corner) that the closest point lies on.

        Their dot product with the connecting line has the right sign for every closed surface (Baerentzen and Aanaes
        2005); a face's own normal has not, near sharp edges.
        """
        result = self._normals[face]
        zero = bary == 0
        for k in range(3):
            on_edge = zero[:, (k + 2) % 3]
            result[on_edge] = self._edge_normals[face[on_edge], k]
        for k in range(3):
            on_corner = zero[:, (k + 1) % 3] & zero[:, (k + 2) % 3]
            result[on_corner] = self._corner_normals[face[on_corner], k]
        return result


def closest_on_triangle(points: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points (N, 3) against triangles (N, 3, 3): barycentrics (N, 3), exact zeros at the border, squared distance (N,).

    The closest point is the projection when that falls inside, else the best of the three edges.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    ab, ac, ap = b - a, c - a, points - a
    d11, d12, d22 = _dot(ab, ab), _dot(ab, ac), _dot(ac, ac)
    d1p, d2p = _dot(ab, ap), _dot(ac, ap)
    determinant = d11 * d22 - d12 * d12
    # of a triangle without area rounding leaves a determinant of either sign; it is its edges
    has_area = determinant > CLOSEST_FLAT * d11 * d22
    safe = np.where(has_area, determinant, 1)
    v, w = (d22 * d1p - d12 * d2p) / safe, (d11 * d2p - d12 * d1p) / safe
    inside = has_area & (v > 0) & (w > 0) & (v + w < 1)
    bary = np.stack([1 - v - w, v, w], axis=1)
    squared = np.full(len(points), np.inf)
    for k in range(3):
        start, edge = corners[:, k], corners[:, (k + 1) % 3] - corners[:, k]
        length = _dot(edge, edge)
        along = np.clip(_dot(points - start, edge) / np.where(length > 0, length, 1), 0, 1)
        gap = points - start - along[:, None] * edge
        distance = _dot(gap, gap)
        better = ~inside & (distance < squared)
        squared = np.where(better, distance, squared)
        on_edge = np.zeros_like(bary)
        on_edge[:, k], on_edge[:, (k + 1) % 3] = 1 - along, along
        bary = np.where(better[:, None], on_edge, bary)
    gap = points - np.einsum("nk,nkc->nc", bary, corners)
    return bary, _dot(gap, gap)


def _each_once(faces: np.ndarray, possible: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rows and faces (M,) of the entries of (N, K) that are possible, each face once a row, in the order of the rows
    and, within a row, of the entries."""
    row, column = np.nonzero(possible)
    face = faces[row, column]
    # stable, so that the first of equal ones comes first
    order = np.argsort(row * (int(faces.max()) + 1) + face, kind="stable")
    first = np.ones(len(order), dtype=bool)
    first[1:] = (np.diff(row[order]) != 0) | (np.diff(face[order]) != 0)
    kept = np.sort(order[first])
    return row[kept], face[kept]


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.einsum("nc,nc->n", a, b)


def _pieces(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Splits faces at the middle of the longest edge until every piece is small.

    Returns centers (P, 3), the face of each piece (P,), and the distance (P,) from each center to the farthest corner.
    """
    face = np.arange(len(corners))
    done_centers, done_faces, done_radii = [], [], []
    while len(corners):
        center = corners.mean(axis=1)
        radius = np.linalg.norm(corners - center[:, None], axis=2).max(axis=1)
        small = (radius <= CLOSEST_PIECE_RADIUS_M) | (2 * len(corners) > CLOSEST_PIECES_MAX)
        done_centers.append(center[small])
        done_faces.append(face[small])
        done_radii.append(radius[small])
        corners, face = _halved(corners[~small]), np.repeat(face[~small], 2)
    return np.concatenate(done_centers), np.concatenate(done_faces), np.concatenate(done_radii)


def _halved(corners: np.ndarray) -> np.ndarray:
    """(N, 3, 3) triangles to (2N, 3, 3): each cut from the middle of its longest edge to the opposite corner."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    first = lengths.argmax(axis=1)
    rows = np.arange(len(corners))
    a, b, c = (corners[rows, (first + k) % 3] for k in range(3))
    middle = (a + b) / 2
    return np.stack([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)], axis=1).reshape(-1, 3, 3)
